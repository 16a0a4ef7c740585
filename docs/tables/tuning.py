"""Table of the page on tuning: what each rule of the budget's use loses."""

import pandas as pd
from docs.tables.record import STUDIES, printed

_RULES = {"sweep": "sweep, then TPE", "tpe": "TPE alone", "tpe_after_5": "TPE after 5 random"}


def _figure(best: float) -> str:
    """Of recorded sets, whose errors [mm] have a minus, as more is better there, too."""
    return f"{best:.3f}" if best > 0 else f"{-best:.3f} mm"


def _rules() -> str:
    stored = pd.read_csv(STUDIES / "tuning" / "rules.csv")
    rows = [
        [
            row["scenario"], f"`{row['method']}`", str(row["sets"]), _figure(row["best"]),
            *(f"{row[rule]:.3f} ({row[f'{rule}_worst']:.3f})" for rule in _RULES),
        ]
        for row in stored.to_dict("records")
    ]  # fmt: skip
    heads = ["scenario", "method", "sets", "best", *_RULES.values()]
    return printed(heads, rows, [False, False, *[True] * (len(heads) - 2)])


TABLES = {"rules of tuning": _rules}
