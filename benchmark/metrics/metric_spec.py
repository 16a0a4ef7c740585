"""The declaration of one figure of methods or operators."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import pandas as pd
from numpy.typing import NDArray

SENSOR = "pixels whose centre lies inside the sensor"
TIME = "time"
SMALL = "small"

CellStatistic = Callable[[pd.DataFrame, NDArray[np.float64]], NDArray[np.float64]]
"""Maps the rows of a cell (n) and how often each is drawn (b, n) to a figure in each draw (b,)."""


Best = Literal["max", "min"] | None


@dataclass(frozen=True)
class MetricSpec:
    """Everything that statistics, tables and documents know of a metric.

    Attributes:
        name: of the column; `title` is printed.
        formula: in words or symbols; t is the truth, p the estimate, both in S/m. Of operators, v
            are the model's clean voltages, w the operator's, z and y the same standardised.
        domain: scenarios it is computed for.
        best: whether the largest or the smallest value is the best; None where a certain one is.
        traps: what it hides or rewards.
        form: format specification of its numbers, `TIME` for durations, `SMALL` for numbers of any
            small size.
        unit: "1" where it has none.
        mask: which pixels or measurements count.
        data_range: the range of conductivity it uses, if any.
        aggregate: makes the figure of a cell from those of its samples; None where the table of
            cells holds it already.
        anchors: values that count as 0 and as 1 in the bounded score, of the metrics in it.
    """

    name: str
    title: str
    formula: str
    domain: str
    best: Best
    traps: str
    form: str
    unit: str = "1"
    mask: str = SENSOR
    data_range: str = "none"
    aggregate: Literal["mean", "median"] | CellStatistic | None = "mean"
    anchors: tuple[float, float] | None = None

    @property
    def heading(self) -> str:
        """The title with the unit, as "PSNR [dB]"."""
        return self.title if self.unit == "1" else f"{self.title} [{self.unit}]"

    @property
    def sign(self) -> float:
        """1 where more is better, -1 where less is."""
        return 1.0 if self.best == "max" else -1.0

    def card(self) -> dict[str, Any]:
        """Plain values for documents and reports."""
        names = (
            "name",
            "title",
            "formula",
            "domain",
            "unit",
            "best",
            "mask",
            "data_range",
            "traps",
        )
        whole = self.aggregate is None or callable(self.aggregate)
        average = "whole scenario" if whole else self.aggregate
        return {name: getattr(self, name) for name in names} | {"average": average}
