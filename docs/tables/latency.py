"""Table of the latency of touch detection, from its record."""

import pandas as pd
from docs.tables.record import STUDIES, printed

from eitbench.reports.tables.latency import latency_rows

_LEFT_OUT = ("material", "dropped")
_SETTINGS = ["snr_db", "reference_age_s"]


def _latency() -> str:
    """Return the latencies in the material that relaxes, and the ghosts in the ideal one."""
    stored = pd.read_csv(STUDIES / "latency" / "latency.csv")
    of = stored.groupby("ideal")
    (heads, *rows), (_, *ideal) = (latency_rows(of.get_group(is_)) for is_ in (False, True))
    kept = [k for k, head in enumerate(heads) if head not in _LEFT_OUT]
    settings = of.get_group(False)[_SETTINGS].to_numpy()
    body = [
        [*(f"{value:g}" for value in about), f"`{row[0]}`", *(row[k] for k in kept[1:]), other[-1]]
        for about, row, other in zip(settings, rows, ideal, strict=True)
    ]
    texts = [head.replace("[", r"\[").replace("]", r"\]") for head in (heads[k] for k in kept)]
    own = [r"SNR \[dB\]", r"reference \[s\]"]
    return printed([*own, *texts, "in an ideal material"], body)


TABLES = {"latency": _latency}
