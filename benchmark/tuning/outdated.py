"""Runs whose parameters are not those that are chosen now."""

from eitbench.benchmark.rundir.manifest import Manifest, suite_of
from eitbench.benchmark.tuning.selection import selected_parameters
from eitbench.methods.registry import methods


def outdated(record: Manifest) -> list[str]:
    """The cells of a record with other parameters than are chosen now, as SCENARIO/METHOD.

    What a choice does not name is as the method has it by default.
    """
    suite = suite_of(record)
    if suite.ranks != "methods":  # what says places is tuned by nobody
        return []
    familiar = {scenario.name: suite.familiar(scenario) for scenario in suite.scenarios}
    known, found = methods(), []
    for cell in record["cells"]:
        if cell["track"] in ("default", "tuned", "calibrated") and cell["name"] in known:
            then, default = cell["parameters"], known[cell["name"]]
            now = selected_parameters(familiar[cell["scenario"]], cell["name"]) or {}
            one, other = (
                {name: of.get(name, getattr(default, name, None)) for name in {**then, **now}}
                for of in (then, now)
            )
            if one != other:
                found.append(f"{cell['scenario']}/{cell['name']}")
    return found
