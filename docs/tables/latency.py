"""Table of the latency of touch detection, from its record."""

import pandas as pd
from docs.tables.record import STUDIES, printed

from eitbench.reports.tables.latency import latency_rows

_LEFT_OUT = ("material", "dropped", "false contacts")


def _latency() -> str:
    """Return the latencies in the material that relaxes, and the ghosts in the ideal one."""
    stored = pd.read_csv(STUDIES / "latency" / "latency.csv")
    of = stored.groupby("ideal")
    (heads, *rows), (_, *ideal) = (latency_rows(of.get_group(is_)) for is_ in (False, True))
    kept = [k for k, head in enumerate(heads) if head not in _LEFT_OUT]
    snrs = of.get_group(False)["snr_db"]
    body = [
        [f"{snr:g}", f"`{row[0]}`", *(row[k] for k in kept[1:]), other[-1]]
        for snr, row, other in zip(snrs, rows, ideal, strict=True)
    ]
    texts = [head.replace("[", r"\[").replace("]", r"\]") for head in (heads[k] for k in kept)]
    return printed([r"SNR \[dB\]", *texts, "in an ideal material"], body)


TABLES = {"latency": _latency}
