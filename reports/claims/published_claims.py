"""The published claims, with their figures, the rules of their verdicts and their commands."""

from functools import partial

from eitbench.reports.claims import rules
from eitbench.reports.claims.claim import Claim

_WITHIN = "SSIM and CC within 0.01, RIE within 10 %, PSNR within 1 dB"

CLAIMS = (
    Claim(
        "table1-ratio",
        "Table I",
        "The learned surrogate predicts voltages better than the Jacobian does.",
        (rules.RATIO_FIGURE,),
        "holds: the ratio is at least 90 % of the published one; in part: above 1",
        "eitbench run operators --operators surrogate,jacobian",
        rules.operator_ratio,
    ),
    *(
        Claim(
            f"table1-{name}",
            "Table I",
            f"The {label} predicts standardised voltages with this error.",
            rules.operator_figures(name),
            "none: the standardisation is not published",
            f"eitbench run operators --operators {name}",
            partial(rules.operator_row, name),
        )
        for name, label in (("surrogate", "learned surrogate"), ("jacobian", "Jacobian"))
    ),
    Claim(
        "table2-phydnn",
        "Table II",
        "PhyDNN reconstructs clean test frames this well.",
        rules.published_row("phydnn"),
        f"as good as published or better: {_WITHIN}; holds: all figures; in part: some",
        "eitbench run paper --methods phydnn",
        partial(rules.learned_row, "phydnn"),
    ),
    *(
        Claim(
            f"table2-{name}",
            "Table II",
            f"{name.upper()}'s images of clean test frames score this.",
            rules.published_row(name),
            f"as published, neither better nor worse: {_WITHIN}, SSIM near or below 0 meaning at "
            f"most {rules.NEAR_ZERO}; holds: all figures; in part: some",
            f"eitbench run paper --methods {name}",
            partial(rules.classical_row, name),
        )
        for name in ("noser", "tv")
    ),
    Claim(
        "phydnn-over-dnn",
        "Table II",
        "The physical loss makes PhyDNN better than DNN, the same network without it.",
        rules.DIFFERENCES,
        "PhyDNN minus DNN, sample by sample: the whole 95 % bootstrap interval of the mean lies on "
        "PhyDNN's side of 0; holds: all four; in part: some",
        "eitbench run paper --methods dnn,phydnn",
        rules.phydnn_over_dnn,
    ),
    Claim(
        "phydnn-over-dnn-seeds",
        "Table II",
        "The physical loss makes PhyDNN better than DNN, whatever the seed of the training.",
        rules.DIFFERENCES,
        "PhyDNN minus DNN, paired by seed and sample: the whole 95 % interval of the mean over "
        "both lies on PhyDNN's side of 0; holds: all four; in part: some",
        "eitbench study physics --out runs/physics && eitbench reproduce --study runs/physics",
        rules.phydnn_over_dnn_with_seeds,
    ),
    Claim(
        "best-beta",
        "beta sweep",
        "The weight beta of the physical loss is best at 0.0029.",
        (rules.BETA_FIGURE,),
        "two rules: the best beta lies within a factor of 2 of the published one; S there is "
        "better than at the published beta by no more than neighbours on the grid differ in the "
        "median; holds: both; in part: one",
        "eitbench study beta --out runs/beta && eitbench reproduce --study runs/beta",
        rules.best_beta,
    ),
    Claim(
        "frame-rate",
        "speed",
        "The networks reconstruct 10 frames per second.",
        rules.RATES,
        "at least 10 frames per second at the 99th percentile of single warm frames; holds: both "
        "networks; in part: one",
        "eitbench run paper --methods dnn,phydnn",
        rules.frame_rate,
    ),
)
