"""How far methods are from the checks that they expect to fail.

Run: python docs/studies/contract/measure.py docs/studies/contract/expected.csv

`measured` is the rms difference between the image of turned (mirrored) voltages and the turned
(mirrored) image, over the contrast, as `eitbench check METHOD` prints it.
"""

import re
import sys

import pandas as pd

from eitbench import __version__
from eitbench.benchmark.checks import check_method
from eitbench.methods import methods
from eitbench.scenarios import sensor

CHECKS = ("rotation_equivariance", "mirror_equivariance")


def main(out: str) -> None:
    """Check the methods that expect to fail these, as far as they can be run here."""
    rows = []
    for name, method in methods().items():
        if method.unusable(sensor("foam16")) or not set(CHECKS) & set(method.expected_failures):
            continue
        for result in check_method(name).results:
            if result.check in CHECKS:
                (measured,) = re.findall(r"differ by ([\d.e-]+) of", result.message)
                rows.append({
                    "method": name, "check": result.check, "measured": measured,
                    "eitbench": __version__,
                })  # fmt: skip
                print(rows[-1], flush=True)
    pd.DataFrame(rows).to_csv(out, index=False, lineterminator="\n")


if __name__ == "__main__":
    main(sys.argv[1])
