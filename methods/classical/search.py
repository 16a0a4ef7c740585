"""Parameters of the classical methods that the validation split may choose, and their values."""

from collections.abc import Mapping, Sequence

from eitbench.methods.classical.linearisation import VARIABLES

Search = Mapping[str, Sequence[object]]

WEIGHTS: Search = {"weight": (1e-5, 1e-4, 3e-4, 1e-3, 3e-3, 1e-2, 3e-2, 0.1, 0.3, 1.0, 3.0)}
ROWS: Search = {"row_exponent": (0.0, 0.5, 1.0)}
UNKNOWN: Search = {"variable": VARIABLES}
ONE_STEP: Search = {**UNKNOWN, **WEIGHTS, **ROWS}
VARIATION: Search = {"weight": (1e-5, 3e-5, 1e-4, 3e-4, 1e-3, 2e-3, 5e-3, 1e-2)}
