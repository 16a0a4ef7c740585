"""The figures of tactile acuity, each declared once: formula, unit, traps."""

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from eitbench.benchmark.metrics.metric_spec import MetricSpec

Table = Literal["acuity", "greit"]


@dataclass(frozen=True)
class AcuitySpec(MetricSpec):
    """A figure of acuity.

    Attributes:
        table: the printed table that it stands in.
        right: its value of a right image, where neither more nor less is better.
    """

    table: Table = "acuity"
    right: float | None = None
    aggregate: None = None

    def card(self) -> dict[str, Any]:
        """See `MetricSpec.card`."""
        return super().card() | ({} if self.right is None else {"best": None})

    def text(self, value: float) -> str:
        """Return the value as printed; a dash where there is none."""
        return "–" if np.isnan(value) else format(value, self.form)


_NO_TOUCH = "touches and frames without a touch, at one level of noise"
_TOUCHES = "detected single touches, at one level of noise"
_EACH = "single touches, at one level of noise"
_FIRMEST = "the firmest single touches, at one level of noise"
_PAIRS = "pairs of touches, at one level of noise"

_SPECS = (
    AcuitySpec(
        "auc",
        "AUC",
        formula="area under the share of touches over the share of untouched frames whose strength"
        " exceeds a threshold, over all thresholds (Mann-Whitney)",
        domain=_NO_TOUCH,
        best="max",
        form=".3f",
        traps="It depends on the ladder of pressures: more firm touches raise it. Compare methods "
        "in one run, not runs with other pressures.",
    ),
    AcuitySpec(
        "smallest_pa",
        "smallest touch",
        formula="pressure from which on half of the touches are detected, interpolated over its "
        "logarithm; detected: stronger than the threshold; median over the places",
        domain=_NO_TOUCH,
        unit="Pa",
        best="min",
        form=",.0f",
        traps="Where every pressure is detected it is the least one that was pressed: an upper "
        "bound. It is that of one indenter: a smaller one presses less at the same pressure. "
        "None where half of the places never feel a touch.",
    ),
    AcuitySpec(
        "smallest_s_mm2",
        "smallest contrast times area",
        formula="the same touch as the integral of its true |contrast|",
        domain=_NO_TOUCH,
        unit="S/m mm²",
        best="min",
        form=".3g",
        traps="As of the smallest touch.",
    ),
    AcuitySpec(
        "error_mm",
        "error",
        formula="median distance of the found place from the true one",
        domain=_TOUCHES,
        unit="mm",
        best="min",
        form=".1f",
        traps="A method that feels firm touches alone has the smaller error. Read it beside the "
        "smallest touch.",
    ),
    AcuitySpec(
        "pull",
        "pull to the centre",
        formula="1 minus the slope of found places over true ones, both from the middle of the "
        "lattice, by least squares; 95 % interval of a bootstrap over places",
        domain=_TOUCHES,
        best="min",
        right=0.0,
        form="z.0%",
        traps="Negative where touches are pushed out. 0 does not mean that there is no bias: "
        "places may be moved around the centre. The map of arrows shows that.",
    ),
    AcuitySpec(
        "least_mm",
        "two points",
        formula="least distance from which on 90 % of the pairs are told apart: the two strongest "
        "contacts lie nearer to their own touch than half the distance, and than 20 mm",
        domain=_PAIRS,
        unit="mm",
        best="min",
        form=".0f",
        traps="Distances are those of the design, so steps of a few mm. A method that shows many "
        "contacts may tell pairs apart by luck: read it beside the false pairs.",
    ),
    AcuitySpec(
        "truth_least_mm",
        "two points in the truth",
        formula="the same of the true images",
        domain=_PAIRS,
        unit="mm",
        best="min",
        form=".0f",
        traps="Beside an indenter foam gives way, so near pairs are one contact even in the truth. "
        "No method can be held to beat it.",
    ),
    AcuitySpec(
        "false_pairs",
        "false pairs",
        formula="share of touches that are shown as several contacts",
        domain=_TOUCHES,
        best="min",
        form=".0%",
        traps="0 also for a method that never shows two contacts.",
    ),
    AcuitySpec(
        "linearity",
        "linearity",
        formula="R² of the line of shown over true strength at a place; median over the places",
        domain=_EACH,
        best="max",
        form=".3f",
        traps="A method that shows a tenth of the strength can be linear.",
    ),
    AcuitySpec(
        "slope_cv",
        "unevenness",
        formula="standard deviation over mean, over the places, of the slope of that line",
        domain=_EACH,
        best="min",
        form=".2f",
        traps="Small also for a method that shows the same of everything.",
    ),
    AcuitySpec(
        "noise_figure",
        "noise figure",
        table="greit",
        formula="(mean |dv| / std n) / (mean |dx| / std m) of the touch nearest to the middle: dv "
        "its change of the voltages by the nominal model, n the noise of frame and reference "
        "frame, dx its image, m the images without a touch",
        domain=_FIRMEST,
        best="min",
        form=".2f",
        traps="Below 1 a method shows less noise than it is given, by smoothing or by prior "
        "knowledge; it says nothing of the place. Meant for linear methods: others have another "
        "one at every noise and strength.",
    ),
    AcuitySpec(
        "amplitude",
        "amplitude response",
        table="greit",
        formula="sum of the image over that of the truth; median over the places",
        domain=_FIRMEST,
        best="max",
        right=1.0,
        form=".2f",
        traps="1 is right, and more is too much. Ringing takes away from it.",
    ),
    AcuitySpec(
        "amplitude_cv",
        "its unevenness",
        table="greit",
        formula="standard deviation over mean of the amplitude response over the places",
        domain=_FIRMEST,
        best="min",
        form=".2f",
        traps="At much noise it is that of the noise: a place has few draws.",
    ),
    AcuitySpec(
        "position_error_mm",
        "position error",
        table="greit",
        formula="distance of the touch from the centre minus that of the middle of its image, "
        "the pixels of at least a quarter of the largest value; median over the places",
        domain=_FIRMEST,
        unit="mm",
        best="min",
        right=0.0,
        form=".1f",
        traps="It has a sign: positive towards the centre. 0 also where the image lies beside the "
        "touch at the same distance from the centre; the error above sees that.",
    ),
    AcuitySpec(
        "resolution",
        "resolution",
        table="greit",
        formula="root of the area of that image over the area of the sensor; median",
        domain=_FIRMEST,
        best="min",
        form=".3f",
        traps="A single bright pixel has the best: a right image is as large as the touch.",
    ),
    AcuitySpec(
        "shape_deformation",
        "shape deformation",
        table="greit",
        formula="share of that image outside the circle of the same area around its middle; median",
        domain=_FIRMEST,
        best="min",
        form=".2f",
        traps="Also of noise: scattered pixels of at least a quarter count.",
    ),
    AcuitySpec(
        "ringing",
        "ringing",
        table="greit",
        formula="minus the sum of values of the other sign outside that image, over the sum "
        "inside; median",
        domain=_FIRMEST,
        best="min",
        form=".2f",
        traps="As EIDORS computes it; in the paper the sum inside is that of the circle. 0 also "
        "where a method keeps its image within a range that ends at the background.",
    ),
)
ACUITY_SPECS = {spec.name: spec for spec in _SPECS}
"""By name, in the order of the tables."""
