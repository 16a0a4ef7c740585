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
AIM = 1.4
"""What a solve with gradient should take, in solves."""
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
    operations, of_gradient = counted_operations()
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
    console.print(of_gradient, highlight=False)
    if record is not None:
        said = {"summary": summary, "gradient": of_gradient}
        figures = {"machine": machine, "tables": list(tables.values()), **said}
        record.write_text(json.dumps(figures, indent=1) + "\n")


def counted_operations() -> tuple[int, str]:
    """Multiplications and additions of one solve, and a sentence on what a gradient adds.

    They follow from the structure of the matrix; of an elimination upper triangles alone count.
    """
    model = forward_model(sensor("foam16"))
    parts, fields = model._parts, model.sensor.n_electrodes
    # Rows that are left below each unknown as it is eliminated.
    below = [
        size - pivot
        for size, count in zip(parts.size.tolist(), parts.eliminated.tolist(), strict=True)
        for pivot in range(1, count + 1)
    ]
    solve = sum(left * (left + 1) for left in below)
    substitution = sum(fields * (2 * left + 1) for left in below)
    products = 2 * fields**2 * len(model.mesh.nodes)
    # u^T K w of a square element has ten different products of its corners.
    elements = 10 * 2 * fields * len(model.mesh.elements)
    added = substitution + products + elements
    return solve, (
        f"Of `foam16`, 80 x 80, an elimination has {solve / 1e6:.1f} million multiplications and "
        f"additions. A gradient adds {added / 1e6:.1f} million: {substitution / 1e6:.1f} for the "
        f"back substitution of {fields} fields, {products / 1e6:.1f} for their products with the "
        f"weights of the loss, {elements / 1e6:.1f} for the sums over elements. At the rate of the "
        f"elimination a solve with gradient would take {1 + added / solve:.2f} times as long as "
        f"one without, and with the back substitution alone {1 + substitution / solve:.2f} times: "
        f"the aim of {AIM:g} times is out of its reach."
    )


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
