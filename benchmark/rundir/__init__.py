"""The run directory: plan, manifest, locked store of rows and arrays."""

from typing import TYPE_CHECKING

from eitbench.scenarios.lazy import lazy_names

if TYPE_CHECKING:
    from eitbench.benchmark.rundir.cells import Batch, Cell
    from eitbench.benchmark.rundir.plan import Plan, make_plan
    from eitbench.benchmark.rundir.store import RunStore

__all__ = ["Batch", "Cell", "Plan", "RunStore", "make_plan"]

# Workers lock a folder without what reads tables and arrays.
__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "Batch": "cells",
        "Cell": "cells",
        "Plan": "plan",
        "RunStore": "store",
        "make_plan": "plan",
    },
)
