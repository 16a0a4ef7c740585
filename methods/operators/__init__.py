"""Forward operators: conductivity to voltages, differentiable in NumPy, torch and JAX."""

from eitbench.methods.operators.fem import Fem
from eitbench.methods.operators.jacobian import Jacobian
from eitbench.methods.operators.surrogate import Surrogate

__all__ = ["Fem", "Jacobian", "Surrogate"]
