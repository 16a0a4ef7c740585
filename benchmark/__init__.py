"""How it is judged: metrics, runner, result store, timing and method checks."""
