"""Tables of pages with one table: simulated data, priors, acuity, operators, peers."""

from functools import cache

import pandas as pd
from docs.tables.record import STUDIES, printed, record, recorded

from eitbench.benchmark.findings.acuity import AcuityResult, acuity_of
from eitbench.benchmark.findings.acuity_specs import Table
from eitbench.reports.findings.acuity import grid
from eitbench.reports.studies.priors import priors_table
from eitbench.reports.tables.published import TABLE_I


@cache
def acuity() -> list[AcuityResult]:
    """What the record of `acuity` says."""
    return acuity_of(record("acuity"))


def _acuity(table: Table) -> str:
    heads, *rows = grid(acuity(), table)
    return printed(heads, [[level, f"`{method}`", *cells] for level, method, *cells in rows])


def _operators() -> str:
    names = {"paper": "same mesh", "paper-finer": "finer mesh"}
    rows = [
        [
            names[row["scenario"]],
            f"`{row['operator']}`",
            f"{row['mse']:.3g}",
            f"{row['r']:.4f}" + (f" ({row['r_low']:.4f} to {row['r_high']:.4f})"),
            f"{100 * row['rel_error']:.2g} %",
            f"{row['grad_cosine']:.3f}",
        ]
        for row in recorded("operators")
    ]
    for name, title in (("surrogate", "learned operator"), ("jacobian", "Jacobian")):
        table = TABLE_I[name]
        rows.append(["published", title, f"{table['mse']:.3g}", f"{table['r']:.5f}", "", ""])
    heads = ["data from", "operator", "MSE", "R (95 %)", "rel. error", "gradient cosine"]
    return printed(heads, rows, [False] * 2 + [True] * 4)


def _peers() -> str:
    """Return figures on simulated touches, and the localisation error of real presses."""
    stored = pd.read_csv(STUDIES / "peers" / "quick.csv")
    touches = stored[stored["scenario"] == "quick"].sort_values("score", ascending=False)
    presses = stored[stored["scenario"] == "ohmc16"].set_index("method")
    columns = {
        "group": ("Ties", ""), "score": ("S", ".3f"), "ssim": ("SSIM", ".3f"), "cc": ("CC", ".3f"),
        "rie": ("RIE", ".4f"), "psnr": ("PSNR [dB]", ".2f"),
    }  # fmt: skip
    rows = []
    for row in touches.to_dict("records"):
        name = row["method"]
        figures = [format(row[column], form) for column, (_, form) in columns.items()]
        pressed = ["", ""]  # not run
        if name in presses.index:
            pressed = [f"{presses['localisation_mm'][name]:.1f}", presses["group"][name]]
        rows.append([f"`{name}`", *figures, *pressed])
    heads = [
        "method",
        *(heading for heading, _ in columns.values()),
        "`ohmc16` without gains [mm]",
        "Ties",
    ]
    return printed(heads, rows)


TABLES = {
    "priors": lambda: priors_table(pd.read_csv(STUDIES / "priors" / "priors.csv")),
    "acuity": lambda: _acuity("acuity"),
    "acuity merit": lambda: _acuity("greit"),
    "operators": _operators,
    "peers": _peers,
}
