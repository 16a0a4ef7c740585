"""Print the table of the exact operator beside its rivals from a file of pytest-benchmark.

`make bench` runs it after the benchmarks: python tests/speed/ratios.py FILE.json
With docs/studies/speed/speed.json as a second argument it writes the record of docs/speed.md.
"""

import json
import sys
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from rich.console import Console
from rich.table import Table

from eitbench.scenarios.catalogue import sensor
from eitbench.scenarios.physics.forward import forward_model
from eitbench.scenarios.physics.registers import WIDE

FORWARD = {
    "test_fem_batch": "eitbench `fem`, batch of 64",
    "test_fem_batch_alike": "eitbench `fem`, batch of 64 that differ in 1/16 of their pixels",
    "test_fem_one_by_one": "eitbench `fem`, 64 images one by one",
    "test_fem_single": "eitbench `fem`, one image",
    "test_fem_batch_and_gradient": "eitbench `fem`, batch of 64, with gradient",
    "test_fem_single_and_gradient": "eitbench `fem`, one image, with gradient",
    "test_sparse_lu[MMD_AT_PLUS_A]": "SciPy LU, best ordering (MMD_AT_PLUS_A, symmetric)",
    "test_sparse_lu[COLAMD]": "SciPy LU, default ordering (COLAMD)",
    "test_pyeit": "pyEIT (point electrodes, triangles)",
}
JACOBIAN = {
    "test_fem_jacobian": "eitbench",
    "test_sparse_lu_jacobian": "SciPy LU, default ordering, and contraction",
}


def main(path: Path, record: Path | None = None) -> None:
    """Print the machine, the ratios and how near the operator comes to its floor.

    With `record` the figures are written there, too, for the documentation.
    """
    run = json.loads(path.read_text())
    cpu, console = run["machine_info"]["cpu"], Console()
    packages = ("numpy", "scipy", "numba", "torch", "pyeit")
    machine = (
        f"{cpu.get('brand_raw', 'unknown processor')}, {cpu.get('count', '?')} cores; "
        f"one thread, vector registers of {512 if WIDE else 256} bits; "
        f"Python {run['machine_info']['python_version']}, "
        + ", ".join(f"{name} {_version(name)}" for name in packages)
    )
    # Per sample [ms], whatever the batch.
    samples = {
        b["name"]: b["stats"]["median"] * 1e3 / b["extra_info"].get("samples", 1)
        for b in run["benchmarks"]
    }
    ours = samples["test_fem_batch"]
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
    gradient = samples["test_fem_single_and_gradient"] / samples["test_fem_single"]
    summary = (
        f"A batch takes {ours / samples['test_fem_one_by_one']:.2f} times as long as its images "
        f"one by one, and with gradient {samples['test_fem_batch_and_gradient'] / ours:.2f} times "
        f"as long as without (one image: {gradient:.2f} times). "
        f"Floor: {operations / 1e6:.1f} million operations an image at {rate / 1e9:.0f} GFLOP/s "
        f"(matrix product, 1000 x 1000, in the same run) would take {floor:.2f} ms; a batch takes "
        f"{ours:.2f} ms an image, so it reaches {floor / ours:.0%} of that."
    )
    tables = {
        "foam16, 80 x 80: voltages of one image": _rows(FORWARD, samples),
        "foam16, 80 x 80: voltages and Jacobian of one image": _rows(JACOBIAN, samples),
    }
    console.print(f"\nMachine: {machine}", highlight=False)
    for title, rows in tables.items():
        table = Table(title=title, title_justify="left")
        table.add_column("")
        table.add_column("ms", justify="right")
        table.add_column("times ours", justify="right")
        for row in rows:
            table.add_row(*row)
        console.print(table)
    console.print(summary, highlight=False)
    if record is not None:
        figures = {"machine": machine, "tables": list(tables.values()), "summary": summary}
        record.write_text(json.dumps(figures, indent=1) + "\n")


def _rows(names: dict[str, str], samples: dict[str, float]) -> list[tuple[str, str, str]]:
    """What was measured, milliseconds, and as a multiple of the first."""
    ours = samples[next(iter(names))]
    return [
        (label, f"{samples[name]:.3g}", f"{samples[name] / ours:.1f}")
        for name, label in names.items()
        if name in samples
    ]


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "missing"


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:]))
