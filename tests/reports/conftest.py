"""Leaderboards as printed."""

import io
from collections.abc import Callable
from typing import Any

import pytest
from rich.console import Console

from eitbench.reports.tables.leaderboard import FORMATS
from eitbench.reports.tables.terminal import table


@pytest.fixture(scope="session")
def printed() -> Callable[..., str]:
    """Rows in one of `FORMATS`, or for a "terminal" of some width."""

    def text(rows: list[dict[str, Any]], form: str, width: int = 200) -> str:
        if form != "terminal":
            return FORMATS[form](rows)
        console = Console(record=True, width=width, file=io.StringIO())
        console.print(table(rows, width))
        return console.export_text()

    return text
