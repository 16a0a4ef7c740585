"""Print the table of the exact operator beside its rivals from a file of pytest-benchmark.

`make bench` runs it after the benchmarks: python tests/speed/ratios.py FILE.json
"""

import json
import sys
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from rich.console import Console
from rich.table import Table

from eitbench.scenarios.catalogue import sensor
from eitbench.scenarios.physics.forward import forward_model

FORWARD = {
    "test_fem_batch": "eitbench `fem`, batch of 64",
    "test_fem_one_by_one": "eitbench `fem`, 64 images one by one",
    "test_fem_single": "eitbench `fem`, one image",
    "test_fem_batch_and_gradient": "eitbench `fem`, batch of 64, with gradient",
    "test_sparse_lu[MMD_AT_PLUS_A]": "SciPy LU, best ordering (MMD_AT_PLUS_A, symmetric)",
    "test_sparse_lu[COLAMD]": "SciPy LU, default ordering (COLAMD)",
    "test_pyeit": "pyEIT (point electrodes, triangles)",
}
JACOBIAN = {
    "test_fem_jacobian": "eitbench",
    "test_sparse_lu_jacobian": "SciPy LU, default ordering, and contraction",
}


def main(path: Path) -> None:
    """Print the machine, the ratios and how near the operator comes to its floor."""
    run = json.loads(path.read_text())
    cpu, console = run["machine_info"]["cpu"], Console()
    packages = ("numpy", "scipy", "numba", "torch", "pyeit")
    console.print(
        f"\nMachine: {cpu.get('brand_raw', 'unknown processor')}, {cpu.get('count', '?')} cores; "
        f"one thread; Python {run['machine_info']['python_version']}, "
        + ", ".join(f"{name} {_version(name)}" for name in packages),
        highlight=False,
    )
    # Per sample [ms], whatever the batch.
    samples = {
        b["name"]: b["stats"]["median"] * 1e3 / b["extra_info"].get("samples", 1)
        for b in run["benchmarks"]
    }
    _print(console, "foam16, 80 x 80: voltages of one image", FORWARD, samples)
    _print(console, "foam16, 80 x 80: voltages and Jacobian of one image", JACOBIAN, samples)
    ours = samples["test_fem_batch"]
    gradient = samples["test_fem_batch_and_gradient"] / ours
    parts = forward_model(sensor("foam16"))._parts
    # Multiplications and additions of one elimination, of upper triangles alone.
    operations = sum(
        (size - pivot) * (size - pivot + 1)
        for size, count in zip(parts.size.tolist(), parts.eliminated.tolist(), strict=True)
        for pivot in range(1, count + 1)
    )
    product = next(b for b in run["benchmarks"] if b["name"] == "test_matrix_product")
    rate = product["extra_info"]["operations"] / product["stats"]["median"]
    floor = operations / rate * 1e3
    console.print(
        f"Forward plus gradient takes {gradient:.2f} times the forward solve.\n"
        f"Floor: {operations / 1e6:.1f} million operations an image at "
        f"{rate / 1e9:.0f} GFLOP/s (matrix product, 1000 x 1000, in this run) would take "
        f"{floor:.2f} ms; `fem` takes {ours:.2f} ms, so it reaches {floor / ours:.0%} of that.",
        highlight=False,
    )


def _print(console: Console, title: str, names: dict[str, str], samples: dict[str, float]) -> None:
    table = Table(title=title, title_justify="left")
    table.add_column("")
    table.add_column("ms", justify="right")
    table.add_column("times ours", justify="right")
    ours = samples[next(iter(names))]
    for name, label in names.items():
        if name in samples:
            table.add_row(label, f"{samples[name]:.2f}", f"{samples[name] / ours:.1f}")
    console.print(table)


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "missing"


if __name__ == "__main__":
    main(Path(sys.argv[1]))
