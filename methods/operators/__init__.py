"""Forward operators: conductivity to voltages, differentiable in NumPy, torch and JAX."""
