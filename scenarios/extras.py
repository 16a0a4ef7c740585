"""Libraries that a base installation lacks, and the extras of the package that bring them."""

from importlib.util import find_spec

EXTRAS = {
    "torch": ("PyTorch", "learned"),
    "optuna": ("Optuna", "tune"),
    "jinja2": ("Jinja", "report"),
    "markupsafe": ("MarkupSafe", "report"),
    "plotly": ("Plotly", "report"),
    "serial": ("pySerial", "live"),
    "starlette": ("Starlette", "live"),
    "uvicorn": ("Uvicorn", "live"),
    "websockets": ("websockets", "live"),
    "distributed": ("Dask", "cluster"),
    "jax": ("JAX", "jax"),
    "openpyxl": ("openpyxl", "excel"),
    "pyeit": ("pyEIT", "peers"),
}
"""By module: the library's name, and the extra that installs it."""


def missing(module: str) -> str:
    """How to install the library of a `module` of `EXTRAS`, as a sentence; "" if it is there."""
    if find_spec(module) is not None:
        return ""
    library, extra = EXTRAS[module]
    return f"{library} is not installed: pip install 'eitbench[{extra}]'."
