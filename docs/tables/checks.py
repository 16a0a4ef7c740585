"""Tables of what tests and checks found: mutants, expected failures, spoilt files."""

import pandas as pd
from docs.tables.record import STUDIES, printed

from eitbench.methods import methods

_MOVED = ("rotation_equivariance", "mirror_equivariance")


def _mutation() -> str:
    score = pd.read_csv(STUDIES / "mutation" / "score.csv")
    counts = ["mutants", "survived", "explained"]
    total = pd.DataFrame([{"module": "all", **score[counts].sum()}])
    rows = pd.concat([score.assign(module="`" + score["module"] + "`"), total]).astype(str)
    return printed(["module", *counts], rows.to_numpy().tolist())


def _expected_failures() -> str:
    """Return how far images of moved voltages are from moved images, and why, as methods say."""
    stored = pd.read_csv(STUDIES / "contract" / "expected.csv")
    measured = stored.pivot_table("measured", "method", "check", sort=False)
    rows = [
        [
            f"`{name}`",
            *("" if pd.isna(row[check]) else f"{row[check]:.2g}" for check in _MOVED),
            methods()[str(name)].expected_failures[_MOVED[0]],
        ]
        for name, row in measured.iterrows()
    ]
    return printed(["method", "turned", "mirrored", "why"], rows, [False, True, True, False])


def _fuzz() -> str:
    """Return what readers did with spoilt files, by kind of file."""
    stored = pd.read_csv(STUDIES / "fuzz" / "fuzz.csv")
    rows = [
        [f"`{row['target']}`", *(f"{row[name]:,}" for name in ("files", "taken", "findings"))]
        for row in stored.to_dict("records")
    ]
    rows.append(["all", *(f"{stored[name].sum():,}" for name in ("files", "taken", "findings"))])
    return printed(["target", "files", "accepted", "findings"], rows)


TABLES = {
    "expected failures": _expected_failures,
    "spoilt files": _fuzz,
    "mutation testing": _mutation,
}
