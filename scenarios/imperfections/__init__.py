"""Differences between a real sensor and its nominal model: noise, imperfections, calibration."""

from typing import TYPE_CHECKING

from eitbench.scenarios.imperfections.imperfections import TYPICAL, Imperfections
from eitbench.scenarios.imperfections.noise import Noise, add_noise
from eitbench.scenarios.lazy import lazy_names

if TYPE_CHECKING:
    from eitbench.scenarios.imperfections.calibration import Calibration, calibrate

__all__ = ["TYPICAL", "Calibration", "Imperfections", "Noise", "add_noise", "calibrate"]

# Few scenarios are calibrated, and SciPy's solvers take time to load.
__getattr__, __dir__ = lazy_names(
    __name__, {"Calibration": "calibration", "calibrate": "calibration"}
)
