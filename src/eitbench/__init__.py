"""eitbench: the benchmark for electrical impedance tomography (EIT) tactile sensing.

- Data: `load`, `training_data`, `load_suite`, `sensor`, `forward_model`.
- Methods: `Method`, `Problem`, `register`, `create`; operators: `Operator`, `operator`.
- Results: `evaluate` runs a suite and returns its leaderboard, `plot` draws an image.

`dir(eitbench)` has all public names, `help(eitbench.load)` what one takes.
"""

from pathlib import Path as _Path

import lazy_loader as _lazy_loader

# In a checkout the sub-packages are the repository's top-level folders; the links beside this
# file serve type checkers and editors, and these lines make it work where links do not exist.
_src = _Path(__file__).resolve().parents[1]
if _src.name == "src" and (_src.parent / "pyproject.toml").is_file():
    __path__.insert(0, str(_src.parent))

__version__ = "0.2.0"

# The stub beside names what users import; it is imported when it is first used.
__getattr__, __dir__, __all__ = _lazy_loader.attach_stub(__name__, __file__)
