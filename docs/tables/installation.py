"""What the base and the extras take, from the record in `docs/studies/installation`."""

import pandas as pd
from docs.tables.record import STUDIES, printed

_OUT = STUDIES / "installation"
_BRINGS = {
    "": "classical methods, metrics, runs, boards, recordings, figures",
    "learned": "networks, forward operators, training (PyTorch)",
    "tune": "`eitbench tune` and `choose` (Optuna)",
    "report": "`eitbench report`, sites and `recordings doctor` (Jinja, Plotly)",
    "live": "boards, the emulated one too, and the live view (pySerial, Starlette)",
    "cluster": "many machines (Dask)",
    "excel": "Excel files in `recordings import`",
    "all": "all of these",
}


def _table() -> str:
    stored = pd.read_csv(_OUT / "installation.csv", keep_default_na=False)
    rows = [
        [f"`eitbench[{row['extra']}]`" if row["extra"] else "`eitbench`", _BRINGS[row["extra"]],
         str(row["packages"]), f"{row['mb']:,.0f}", f"{row['s']:.0f}"]
        for row in stored.to_dict("records")
    ]  # fmt: skip
    heads = ["installs", "for", "packages", "MB on disk", "seconds"]
    return printed(heads, rows, [False, False, True, True, True])


TABLES = {"installation": _table}
