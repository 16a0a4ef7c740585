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


def case_samples(run: Run, scenario: str) -> list[int]:
    """The numbers of the samples that stand for the published cases, in their order.

    They are the first samples of their families in the test split: nobody chose them. Empty where
    the scenario has no cases, or the run does not hold them by all `METHODS`.
    """
    table = run.samples[run.samples["scenario"] == scenario]
    if run.kind != METHOD_RUNS or scenario not in FAMILIES or "family" not in table:
        return []
    families = FAMILIES[scenario][1]
    of = table.drop_duplicates("sample").groupby("family")["sample"].apply(sorted).to_dict()
    lacking = any(len(of.get(family, [])) < families.count(family) for family in families)
    if lacking or not set(METHODS) <= set(table["method"]):
        return []
    return [int(of[family][families[:k].count(family)]) for k, family in enumerate(families)]


def published_cases(run: Run) -> Iterator[tuple[str, ImageGrid]]:
    """Yield the name of each scenario whose cases a run of methods holds, with their grid."""
    for scenario, (first, _) in FAMILIES.items():
        samples = case_samples(run, scenario)
        # A record may hold the images of other samples.
        if not samples or len(run.scene(scenario, sorted(samples)).sample) < len(samples):
            continue
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
