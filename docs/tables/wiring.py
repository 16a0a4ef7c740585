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


def _in_short() -> str:
    """Return what the doctor answers on tanks and skins."""
    stored = pd.read_csv(STUDIES / "wiring" / "wiring.csv")
    skin = stored["set"].str.match("ohmc|superpose|hydrogel")
    stored["kind"] = skin.map({True: "skins", False: "tanks"})
    rows = _shares(stored.sort_values(["evidence", "kind"]), ["kind", "evidence"])
    return printed(["", "beside the", *_HEADS], rows)


def _misfits() -> str:
    """Return what wirings leave of the untouched frame beside the model."""
    stored = pd.read_csv(STUDIES / "wiring" / "misfits.csv")
    rows = [
        [f"`{row['set']}`", f"{100 * row['right']:.1f} %", f"{100 * row['best']:.1f} %"]
        for row in stored.to_dict("records")
    ]
    return printed(["set", "right wiring", "best wiring"], rows)


TABLES = {
    "wiring by set": _by_set,
    "wiring by fault": _by_fault,
    "wiring in short": _in_short,
    "wiring misfits": _misfits,
}
