"""The cases that the paper shows images of, simulated and pressed, as they are here."""

from collections.abc import Iterator
from dataclasses import replace

from eitbench.benchmark.analysis.results import Run
from eitbench.benchmark.rundir.kinds import METHOD_RUNS
from eitbench.benchmark.studies.reproduce import METHODS
from eitbench.reports.figures.image_grid import ImageGrid, comparison

FAMILIES = {
    # Cases 1 to 7, as far as the text tells them apart; the order of the others is ours.
    "paper": (
        1, ("two-circles", "two-circles", "two-circles", "triangle", "ring", "l-shape", "rectangle")
    ),
    "objects": (
        8,
        ("object-disc", "object-small-disc", "object-triangle", "object-l-shape", "object-ring",
         "object-rectangle"),
    ),
}  # fmt: skip
"""Number of the first case of a scenario, and the families of its cases."""


def published_cases(run: Run) -> Iterator[tuple[str, ImageGrid]]:
    """Yield the names of the scenarios that a run of methods holds the cases of, and their grids.

    The cases are the first samples of their families in the test split: nobody chose them.
    """
    if run.kind != METHOD_RUNS:
        return
    for scenario, (first, families) in FAMILIES.items():
        table = run.samples[run.samples["scenario"] == scenario]
        if "family" not in table or not set(METHODS) <= set(table["method"]):
            continue
        of = table.drop_duplicates("sample").groupby("family")["sample"].apply(sorted).to_dict()
        if any(len(of.get(family, [])) < families.count(family) for family in families):
            continue
        samples = [int(of[family][families[:k].count(family)]) for k, family in enumerate(families)]
        grid = comparison(run, scenario, METHODS, sorted(samples))
        rows = dict(zip(sorted(samples), grid.rows, strict=True))
        cases = [rows[sample] for sample in samples]
        yield (
            scenario,
            replace(
                grid,
                rows=tuple(
                    ((f"case {first + k}", *label), tiles) for k, (label, tiles) in enumerate(cases)
                ),
            ),
        )
