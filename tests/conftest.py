"""What all tests share: where independent reference data lie, and a cache of their own."""

import os
from pathlib import Path

import pytest

# One thread: the suite runs on small machines, and results must not depend on the thread count.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_NUM_THREADS", "1")

SHARED = Path(__file__).resolve().parents[2] / "shared"


@pytest.fixture(scope="session")
def reference_file() -> Path:
    """Voltages and Jacobian of foam16 computed with EIDORS; see tests/physics/test_reference.py."""
    path = SHARED / "reference" / "foam16_eidors.npz"
    if not path.is_file():
        pytest.skip(
            "The EIDORS reference foam16_eidors.npz is not beside the checkout (../shared)."
        )
    return path
