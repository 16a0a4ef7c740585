"""Files of frames of every kind that is read, for the tests of imports."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pandas as pd
import scipy.io

from eitbench.scenarios.recordings.files.recording_file import Content
from eitbench.scenarios.sensors.patterns import ring_pattern

VALUES = np.random.default_rng(1).normal(size=(6, 40)) * 1e-3
NAMES = [f"v{k}" for k in range(40)]

Import = Callable[..., tuple[Content, str]]
KINDS = [
    "plain.csv", "mark.csv", "named.csv", "numbered.csv", "indexed.csv", "pairs.csv",
    "shuffled.csv", "CAPITALS.CSV", "tabs.tsv", "spaces.txt", "decimal.csv", "percent.txt",
    "columns.csv", "matlab.mat", "columns.mat", "cube.mat", "one.npy", "many.npz", "full.npz",
    "driven.npz", "stacked.csv", "excel.xlsx", "sheets.xlsx", "any.h5", "v73.mat",
]  # fmt: skip


def full_matrices(values: Any, driven: float) -> Any:
    """(n, 8, 8): what the pattern of `skin` leaves out is `driven`."""
    full = np.full((len(values), 64), driven, dtype=values.dtype)
    rows = ring_pattern(8, 3, 3, driven=True).table
    kept = [k for k, (src, sink, a, b) in enumerate(rows) if not {src, sink} & {a, b}]
    full[:, kept] = values
    return full.reshape(-1, 8, 8)


def save(path: Path, values: Any) -> None:
    """`values` (n, 40) as a file of each kind."""
    plain: dict[str, Callable[[], object]] = {
        "plain.csv": lambda: np.savetxt(path, values, delimiter=",", fmt="%.17g"),
        "mark.csv": lambda: np.savetxt(
            path, values, delimiter=",", fmt="%.17g", encoding="utf-8-sig"
        ),
        "named.csv": lambda: pd.DataFrame(values, columns=NAMES).to_csv(path, index=False),
        "numbered.csv": lambda: pd.DataFrame(values).to_csv(path, index=False),
        "indexed.csv": lambda: pd.DataFrame(values).to_csv(path),
        "pairs.csv": lambda: pd.DataFrame(
            values, columns=[f"D{k // 5} S{k % 5}" for k in range(40)]
        ).to_csv(path, index=False),
        "shuffled.csv": lambda: pd.DataFrame(values, columns=NAMES)[sorted(NAMES)].to_csv(path),
        "CAPITALS.CSV": lambda: np.savetxt(path, values, delimiter=",", fmt="%.17g"),
        "tabs.tsv": lambda: np.savetxt(path, values, delimiter="\t", fmt="%.17g"),
        "spaces.txt": lambda: np.savetxt(path, values, header="by hand", fmt="%.17g"),
        "decimal.csv": lambda: pd.DataFrame(values).to_csv(path, sep=";", decimal=","),
        "percent.txt": lambda: np.savetxt(path, values, comments="% ", header="x", fmt="%.17g"),
        "columns.csv": lambda: np.savetxt(path, values.T, delimiter=",", fmt="%.17g"),
        "matlab.mat": lambda: scipy.io.savemat(path, {"volts": values, "fs": 10.0}),
        "columns.mat": lambda: scipy.io.savemat(path, {"volts": values.T, "note": "by hand"}),
        "cube.mat": lambda: scipy.io.savemat(path, {"volts": values.reshape(2, 3, 40)}),
        "one.npy": lambda: np.save(path, values),
        "many.npz": lambda: np.savez(path, volts=values, time=np.arange(6)),
        "full.npz": lambda: np.savez(path, volts=full_matrices(values, 0.0)),
        "driven.npz": lambda: np.savez(path, volts=full_matrices(values, 9.0).reshape(-1, 64)),
        "stacked.csv": lambda: np.savetxt(path, values.reshape(-1, 5), delimiter=",", fmt="%.17g"),
        "excel.xlsx": lambda: pd.DataFrame(values, columns=NAMES).to_excel(path, index=False),
        "sheets.xlsx": lambda: sheets(path, values),
        "any.h5": lambda: hdf5(path, {"run/v": values, "run/t": np.arange(6)}),
        "v73.mat": lambda: hdf5(path, {"v": values.T}, userblock=True),
    }
    plain[path.name]()


def sheets(path: Path, values: Any) -> None:
    with pd.ExcelWriter(path) as writer:
        pd.DataFrame(values).to_excel(writer, sheet_name="Volts", index=False, header=False)
        pd.DataFrame({"t": [1, 2]}).to_excel(writer, sheet_name="Times", index=False)


def hdf5(path: Path, arrays: Mapping[str, Any], *, userblock: bool = False) -> None:
    with h5py.File(path, "w", userblock_size=512 if userblock else 0) as file:
        for name, array in arrays.items():
            file[name] = array
    if userblock:
        with path.open("r+b") as stream:
            stream.write(b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM")
