"""The contract of methods and operators, as checks."""
