"""A card per figure of forward operators."""

from eitbench.benchmark.metrics.specs import SENSOR, MetricCard

_OPERATORS = "forward operators on simulated scenarios"
_ALL_VOLTAGES = "all measurements"
_NOT_ACCURACY = "does not apply"

OPERATOR_METRICS: dict[str, MetricCard] = {
    card.name: card
    for card in (
        MetricCard(
            "mse",
            "MSE",
            "mean (y - z)^2; standardised: every measurement minus its mean, over its standard "
            "deviation, both over the clean voltages of the scenario's whole validation split",
            _OPERATORS,
            "1",
            "min",
            _ALL_VOLTAGES,
            "none",
            "mean",
            "1 is the error of always answering the mean. Standardising weighs every measurement "
            "alike, so the small ones, far from the drive, count as much as the large ones. It "
            "depends on the phantoms of the validation split: figures for other phantoms, "
            "published ones included, do not compare to the digit. On data of the operator's own "
            "mesh it says nothing of the discretisation.",
        ),
        MetricCard(
            "r",
            "R",
            "Pearson correlation of y and z over all samples and measurements at once",
            _OPERATORS,
            "1",
            "max",
            _ALL_VOLTAGES,
            "none",
            "whole scenario",
            "Blind to a common scale and offset. Close to 1 it hardly moves: 0.97 and 0.995 are an "
            "error six times as large in MSE. Not defined where all answers are alike.",
        ),
        MetricCard(
            "rel_error",
            "Relative error",
            "||w - v|| / ||v||, in V/A, not standardised",
            _OPERATORS,
            "1",
            "min",
            _ALL_VOLTAGES,
            "none",
            "mean",
            "Relative to the whole voltage, of which a touch changes a small part: always "
            "answering the untouched sensor's voltages scores well. The large voltages beside the "
            "drive rule it.",
        ),
        MetricCard(
            "grad_cosine",
            "Gradient cosine",
            "cosine of the angle between J(t)^T g of the operator and of the model the data come "
            "from, g = v - v of the untouched sensor; where the data's mesh is finer, its gradient "
            "with respect to a pixel is the sum over the finer pixels in it (chain rule)",
            _OPERATORS,
            "1",
            "max",
            SENSOR,
            "none",
            "mean",
            "Direction only: a gradient of the wrong length scores 1. One cotangent a sample, the "
            "same for all operators, along which a reconstruction would first move; other "
            "directions are not looked at. Pixels at the rim, where gradients are largest, rule "
            "it. A gradient of zero has no direction; it counts as 0 and its row is flagged "
            "`grad_undefined`.",
        ),
    )
}

OPERATOR_COSTS: dict[str, MetricCard] = {
    name: MetricCard(
        name,
        title,
        formula,
        _OPERATORS,
        unit,
        "min",
        _NOT_ACCURACY,
        "none",
        "whole scenario",
        traps,
    )
    for name, title, unit, formula, traps in (
        (
            "forward_ms",
            "Forward",
            "ms",
            "time of `voltages` for a batch of 64 samples over 64, in the operator's precision "
            "(float32 for the surrogate, else float64); median over warm batches, one thread",
            "A batch is what training needs; one sample alone takes longer than this. Smaller runs "
            "have smaller batches, and cells that run side by side disturb each other.",
        ),
        (
            "grad_ms",
            "Gradient",
            "ms",
            "time of one `vjp`, its forward pass included, measured like the forward time",
            "Not the extra time of the gradient: subtract the forward time for that.",
        ),
        (
            "setup_s",
            "Set-up",
            "s",
            "time to make the operator for the sensor",
            "Loading libraries is left out, and so is what the operator postpones to its first "
            "answer, such as compiling: that is in `first_frame_ms`.",
        ),
        (
            "memory_mb",
            "Memory",
            "MiB",
            "peak resident memory of the operator's process",
            "Libraries are in it, some 250 MiB, and a batch of images and gradients.",
        ),
        (
            "train_s",
            "Training",
            "s",
            "time its weights took to train, as their file says; 0 where nothing is trained",
            "On the device named in `trained_on`, not on this machine, and without the simulation "
            "of its training data or the search for its settings.",
        ),
    )
}
