"""What was published of forward operators, to be read beside what is measured here."""

from collections.abc import Sequence

from eitbench.benchmark.results import Row

PAPER = "PhyDNN, Physics-Driven Learning Framework for Tomographic Tactile Sensing"
# Standardised MSE and correlation R, as the paper's table has them.
PUBLISHED = {"surrogate": (2.57e-3, 0.99498), "jacobian": (1.62e-2, 0.97123)}
SCENARIOS = ("paper", "paper-finer")  # those whose phantoms follow the paper
RATIO = PUBLISHED["jacobian"][0] / PUBLISHED["surrogate"][0]


def published_rows(board: Sequence[Row]) -> list[Row]:
    """The published table as rows like those of `board`: None wherever nothing was published.

    There are none beside scenarios that are not the paper's.
    """
    if board[0]["scenario"] not in SCENARIOS:
        return []
    return [
        dict.fromkeys(board[0]) | {"operator": f"{name} (published)", "mse": mse, "r": r}
        for name, (mse, r) in PUBLISHED.items()
    ]


def comparison(board: Sequence[Row]) -> list[str]:
    """How the figures of an operators' board are to be read beside the published ones."""
    said = [
        "MSE and R: every measurement standardised over the clean voltages of the validation split",
    ]
    of_paper = board[0]["scenario"] in SCENARIOS
    if of_paper:
        said.append(
            f"published: {PAPER}, on its own data, with a standardisation it does not state"
        )
    if board[0]["inverse_crime"]:
        said.append("the data come from the exact operator's own mesh (inverse crime)")
    errors = {row["operator"]: row["mse"] for row in reversed(board)}
    surrogate, jacobian = errors.get("surrogate"), errors.get("jacobian")
    if surrogate and jacobian:
        said.append(
            f"the surrogate's MSE is {jacobian / surrogate:.3g} times lower than the Jacobian's"
            + (f" (published: {RATIO:.1f})" if of_paper else "")
        )
    return said
