"""eitbench: the benchmark for electrical impedance tomography (EIT) tactile sensing."""

from pathlib import Path as _Path
from typing import TYPE_CHECKING

# In a checkout the sub-packages are the repository's top-level folders; the links beside this
# file serve type checkers and editors, and these lines make it work where links do not exist.
_src = _Path(__file__).resolve().parents[1]
if _src.name == "src" and (_src.parent / "pyproject.toml").is_file():
    __path__.insert(0, str(_src.parent))

from eitbench.scenarios.lazy import lazy_names  # noqa: E402, found by the lines above

if TYPE_CHECKING:
    from eitbench.methods import (
        Method,
        Operator,
        Problem,
        create,
        load_plugin,
        operator,
        register,
        register_operator,
    )
    from eitbench.methods.registry import operators
    from eitbench.scenarios import (
        Dataset,
        EitbenchError,
        ForwardModel,
        InputError,
        RecordedScenario,
        Sensor,
        SimulatedScenario,
        Suite,
        forward_model,
        load,
        load_suite,
        sensor,
    )

__version__ = "0.1.0"

__all__ = [
    "Dataset",
    "EitbenchError",
    "ForwardModel",
    "InputError",
    "Method",
    "Operator",
    "Problem",
    "RecordedScenario",
    "Sensor",
    "SimulatedScenario",
    "Suite",
    "create",
    "forward_model",
    "load",
    "load_plugin",
    "load_suite",
    "operator",
    "operators",
    "register",
    "register_operator",
    "sensor",
]

# `eitbench.methods` is the subpackage: its function `methods` is `eitbench.methods.methods`.
__getattr__, __dir__ = lazy_names(
    __name__,
    dict.fromkeys(__all__, "scenarios")
    | {
        "Method": "methods.method",
        "Operator": "methods.operator",
        "Problem": "methods.problem",
        "create": "methods.registry",
        "load_plugin": "methods.registry",
        "operator": "methods.registry",
        "operators": "methods.registry",
        "register": "methods.registry",
        "register_operator": "methods.registry",
    },
)
