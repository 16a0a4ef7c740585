"""The run directory: plan, manifest, locked store of rows and arrays."""

from typing import TYPE_CHECKING

from eitbench.scenarios.lazy import lazy_names

if TYPE_CHECKING:
    from eitbench.benchmark.rundir.plan import make_plan
    from eitbench.benchmark.rundir.store import RunStore

__all__ = ["RunStore", "make_plan"]

# Workers lock a folder without what reads tables and arrays.
__getattr__, __dir__ = lazy_names(__name__, {"make_plan": "plan", "RunStore": "store"})
