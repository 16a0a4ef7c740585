"""Figures in sentences, read from the same records as tables.

A figure stands in a sentence as `<!-- figure: SOURCE NAME FORMAT COLUMN=VALUE ... -->23.4<!-- end
-->`, all on one line:

- `SOURCE` is a CSV or JSON file of a record, from `docs/studies` or from the root of the
  repository, or a Python file, for a constant of the code; or `ledger`, that of the published
  claims;
- `NAME` is a column; of JSON the keys that lead there, with dots between; of Python a name;
- `FORMAT` is that of Python's `format`, such as `.1f`, or `s` for text;
- `COLUMN=VALUE` choose the one row; of JSON one entry of the first list on the way.
"""

import json
import re
from collections.abc import Mapping
from functools import lru_cache
from importlib import import_module
from pathlib import Path
from typing import Any

import pandas as pd
from docs.tables.claims import ledger
from docs.tables.record import DOCS, STUDIES

from eitbench.scenarios.errors import InputError

_FIGURE = re.compile(r"(<!-- figure: (.+?) -->)([^<]*)(<!-- end -->)")
# There a comment ends a paragraph, in Markdown as GitHub reads it.
_BEGINS_A_LINE = re.compile(r"^[ \t>*-]*<!-- figure: .*", flags=re.MULTILINE)


def with_figures(text: str) -> str:
    """Return a page with its figures read anew.

    Raises:
        InputError: a figure has no record, no row or several, no such column, or no end.
    """
    if found := _BEGINS_A_LINE.search(text):
        raise InputError(f"A figure begins a line; put a word before it: {found[0][:100]}")
    if text.count("<!-- figure: ") != len(_FIGURE.findall(text)):
        raise InputError("A figure has no `<!-- end -->` behind it.")
    return _FIGURE.sub(lambda of: of[1] + figure(of[2]) + of[4], text)


def figure(asked: str) -> str:
    """Return a figure as it is printed, by the words of its marker (see above)."""
    words = asked.split()
    if len(words) < 3 or any("=" not in word for word in words[3:]):
        raise InputError(f"A figure is SOURCE NAME FORMAT COLUMN=VALUE ..., unlike {asked!r}.")
    source, name, form = words[:3]
    chosen = dict(word.split("=", 1) for word in words[3:])
    content = _content(source)
    if source.endswith(".csv"):
        content, chosen = _row(content, chosen, asked), {}
    value = _value(content, name, chosen, asked)
    try:
        return format(value, form)
    except (TypeError, ValueError) as error:
        raise InputError(f"{value!r} is not printed as {form!r}, in {asked!r}.") from error


def _existing(source: str) -> Path:
    for root in (STUDIES, DOCS.parent):
        if (root / source).is_file() and Path(source).suffix in (".csv", ".json", ".py"):
            return root / source
    raise InputError(f"No CSV, JSON or Python file {source!r} in docs/studies or the repository.")


def _content(source: str) -> Any:
    if source == "ledger":
        return ledger()
    path = _existing(source)
    if path.suffix == ".py":
        module = path.relative_to(DOCS.parent).with_suffix("").as_posix().replace("/", ".")
        return import_module(f"eitbench.{module}")
    return _table(path) if path.suffix == ".csv" else json.loads(path.read_text())


def _value(content: Any, name: str, chosen: Mapping[str, str], asked: str) -> Any:
    for key in name.split("."):
        if chosen and isinstance(content, list):
            content, chosen = _row(content, chosen, asked), {}
        content = _entry(content, key, asked)
    return content


@lru_cache
def _table(path: Path) -> list[dict[str, Any]]:
    """Rows of a CSV file."""
    rows: list[dict[str, Any]] = pd.read_csv(path).to_dict("records")
    return rows


def _row(rows: list[dict[str, Any]], chosen: Mapping[str, str], asked: str) -> dict[str, Any]:
    for name in chosen:
        if not any(name in row for row in rows):
            raise InputError(f"There is no column {name!r} for {asked!r}.")
    found = [row for row in rows if all(str(row.get(key)) == text for key, text in chosen.items())]
    if len(found) != 1:
        raise InputError(f"{len(found) or 'No'} rows fit {asked!r}; a figure is of one.")
    return found[0]


def _entry(content: Any, key: str, asked: str) -> Any:
    try:
        if isinstance(content, Mapping):
            return content[key]
        return content[int(key)] if isinstance(content, list) else getattr(content, key)
    except (AttributeError, IndexError, KeyError, ValueError) as error:
        raise InputError(f"There is no {key!r} where {asked!r} asks for it.") from error
