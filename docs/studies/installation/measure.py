"""What the base and each extra take: `python -m docs.studies.installation.measure`.

Each is installed from the checkout into a fresh environment, with pip's cache; `installation.csv`
has the number of packages, their size on disk and the time. Times depend on the network.
"""

import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import pandas as pd
from docs.tables.record import DOCS, STUDIES

from eitbench.benchmark.rundir.manifest import environment

OUT = STUDIES / "installation"
EXTRAS = ("", "learned", "tune", "report", "live", "cluster", "excel", "all")


def measure(extra: str) -> dict[str, object]:
    """Install the package with one extra ("" for none) and see what that takes."""
    root = DOCS.parent
    with tempfile.TemporaryDirectory() as folder:
        subprocess.run([sys.executable, "-m", "venv", folder], check=True)
        (packages,) = Path(folder).glob("lib/python*/site-packages")
        before = size(packages)
        target = f"{root}[{extra}]" if extra else str(root)
        command = [f"{folder}/bin/python", "-m", "pip", "install", "--quiet"]
        start = time.perf_counter()
        subprocess.run([*command, "-c", str(root / "constraints.txt"), target], check=True)
        seconds = time.perf_counter() - start
        count = len(list(packages.glob("*.dist-info")))
        return {"extra": extra, "packages": count, "mb": size(packages) - before, "s": seconds}


def size(folder: Path) -> float:
    """Size of all files of `folder` [MB]."""
    return sum(path.stat().st_size for path in folder.rglob("*") if path.is_file()) / 1e6


if __name__ == "__main__":
    about = environment()
    table = pd.DataFrame([measure(extra) for extra in EXTRAS])
    table.to_csv(OUT / "installation.csv", index=False, float_format="%.3g", lineterminator="\n")
    (OUT / "installation.json").write_text(json.dumps(about, indent=1) + "\n")
