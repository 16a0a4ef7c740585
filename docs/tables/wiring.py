"""Tables of the doctor of wiring, from its record."""

import pandas as pd
from docs.tables.record import STUDIES, printed


def _shares(stored: pd.DataFrame, by: list[str]) -> list[list[str]]:
    rows = []
    for names, of in stored.groupby(by, sort=False):
        n = int(of["n"].sum())
        shares = (of[name].sum() / n for name in ("right", "whole", "wrong", "refused"))
        rows.append([*map(str, names), f"{n:,}", *(f"{100 * share:.1f} %" for share in shares)])
    return rows


_HEADS = ("ways", "right", "with start", "wrong", "refused")


def _by_set() -> str:
    """Return what the doctor answers on each set."""
    stored = pd.read_csv(STUDIES / "wiring" / "wiring.csv")
    stored["set"] = "`" + stored["set"] + "`"
    return printed(["set", "beside the", *_HEADS], _shares(stored, ["set", "evidence"]))


def _by_fault() -> str:
    """Return what the doctor answers by kind of fault, of all sets."""
    stored = pd.read_csv(STUDIES / "wiring" / "wiring.csv")
    stored["fault"] = stored["fault"].replace(
        {"none": "–", "dead": "an electrode without contact", "swapped": "two interchanged"}
    )
    rows = _shares(stored.sort_values(["evidence", "fault"]), ["fault", "evidence"])
    return printed(["fault", "beside the", *_HEADS], rows)


TABLES = {"wiring by set": _by_set, "wiring by fault": _by_fault}
