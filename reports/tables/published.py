"""The published figures, which stand beside those that are measured here."""

from collections.abc import Mapping, Sequence

from eitbench.benchmark.analysis.leaderboard import Row

PAPER = "PhyDNN, Physics-Driven Learning Framework for Tomographic Tactile Sensing"

Table = Mapping[str, Mapping[str, float]]
"""Figures by the name of an operator or method, then by the column they stand in."""

# Mean squared error and correlation R of forward operators, of voltages in a unit not stated.
TABLE_I: Table = {
    "surrogate": {"mse": 2.57e-3, "r": 0.99498},
    "jacobian": {"mse": 1.62e-2, "r": 0.97123},
}
RATIO = TABLE_I["jacobian"]["mse"] / TABLE_I["surrogate"]["mse"]
TABLE_II: Table = {
    "noser": {"ssim": -0.0127, "cc": 0.1207, "rie": 1.2130, "psnr": -1.0795},
    "tv": {"ssim": -0.3570, "cc": 0.0696, "rie": 1.5661, "psnr": -3.3490},
    "dnn": {"ssim": 0.9754, "cc": 0.9875, "rie": 0.0295, "psnr": 33.1230},
    "phydnn": {"ssim": 0.9765, "cc": 0.9880, "rie": 0.0290, "psnr": 33.2950},
}
BETA = 0.0029
"""The weight of the physical loss that was found to be the best of 52."""
BETA_OF_MEANS = BETA * 208 / 6400
"""The same for our losses, which are means: if the published norms are sums of squares over 80 x 80
pixels and 208 measurements, whose voltages have a variance of 1."""

# The scenarios whose phantoms follow the paper, by what is ranked on them.
_TABLES: Mapping[str, tuple[Table, tuple[str, ...]]] = {
    "operator": (TABLE_I, ("paper", "paper-finer")),
    "method": (TABLE_II, ("paper",)),
}


def published_rows(board: Sequence[Row]) -> list[Row]:
    """The published table as rows like those of `board`: None wherever no figure is known.

    There are none beside scenarios that are not the paper's.
    """
    name = _ranked(board)
    table, scenarios = _TABLES[name]
    if board[0]["scenario"] not in scenarios:
        return []
    return [
        dict.fromkeys(board[0]) | {name: f"{of} (published)", **figures}
        for of, figures in table.items()
    ]


def comparison(board: Sequence[Row]) -> list[str]:
    """Return notes on reading the figures of a board beside the published ones."""
    name = _ranked(board)
    of_paper = board[0]["scenario"] in _TABLES[name][1]
    if name == "operator":
        return _of_operators(board, of_paper)
    if not of_paper:
        return []
    notes = [f"published: {PAPER}, Table II, on its own data"]
    if board[0]["inverse_crime"]:
        notes.append("the data come from the mesh that methods invert with (inverse crime)")
    return notes


def _ranked(board: Sequence[Row]) -> str:
    return "operator" if "operator" in board[0] else "method"


def _of_operators(board: Sequence[Row], of_paper: bool) -> list[str]:
    notes = [
        "MSE: every measurement standardised over the clean voltages of the validation split; R: "
        "of the responses to the touch",
    ]
    if of_paper:
        notes.append(
            f"published: {PAPER}, on its own data, with a standardisation it does not state"
        )
    if board[0]["inverse_crime"]:
        notes.append("the data come from the exact operator's own mesh (inverse crime)")
    errors = {row["operator"]: row["mse"] for row in reversed(board)}
    surrogate, jacobian = errors.get("surrogate"), errors.get("jacobian")
    if surrogate and jacobian:
        notes.append(
            f"the surrogate's MSE is {jacobian / surrogate:.3g} times lower than the Jacobian's"
            + (f" (published: {RATIO:.1f})" if of_paper else "")
        )
    return notes
