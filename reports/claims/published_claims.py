"""The claims of the paper in its order, with their figures, rules and commands."""

from functools import partial

from eitbench.reports.claims import rules
from eitbench.reports.claims.claim import Claim

_WITHIN = "SSIM and CC within 0.01, RIE within 10 %, PSNR within 1 dB"
_INTERVALS = (
    "each figure holds where its whole 95 % interval meets the rule, does not where all of it "
    "misses, and is undecided otherwise; the claim holds where all figures do, holds in part where "
    "one does and another does not, and does not hold where one does not and none does"
)
_PAPER = "eitbench run paper --methods noser,tv,dnn,phydnn"
_OPERATORS = "eitbench run operators --operators surrogate,jacobian,fem"
_RANGES = ("noise-60db", "noise-50db", "noise-40db", "noise-30db")
_OVER_DNN = (("phydnn", "dnn"),)
_OBJECT_METRICS = (*rules.IMAGE_METRICS, *rules.SHAPE_METRICS)
_OVER_CLASSICAL = tuple((a, b) for a in ("dnn", "phydnn") for b in ("noser", "tv"))


CLAIMS = (
    Claim(
        "exact-gradient",
        "Section II-C",
        "The derivative of numerical solvers such as EIDORS and pyEIT is too costly for end-to-end "
        "learning (tested as: of eitbench's exact model).",
        (rules.COST_FIGURE,),
        f"at least {rules.PROHIBITIVE:g} times the cost of the learned operator's gradient",
        _OPERATORS,
        rules.exact_gradient,
    ),
    Claim(
        "unsupervised-rate",
        "Section II-B",
        "Unsupervised schemes (alpha = 0) lack real-time capability.",
        rules.UNSUPERVISED,
        "fewer frames per second than the sensor's 10",
        "eitbench run objects --methods dip,phydnn --limit 12",
        rules.unsupervised_rate,
    ),
    Claim(
        "table1-order",
        "Table I",
        "The learned operator predicts voltages better than the Jacobian does.",
        (rules.ERROR_FIGURE,),
        f"mean difference of errors on the same samples; {_INTERVALS}",
        _OPERATORS,
        rules.operator_order,
    ),
    Claim(
        "table1-ratio",
        "Table I",
        "The learned operator's error is 6.3 times smaller than the Jacobian's.",
        (rules.RATIO_FIGURE,),
        "the ratio is within 10 % of the published one, on either side",
        _OPERATORS,
        rules.operator_ratio,
    ),
    *(
        Claim(
            f"table1-{name}",
            "Table I",
            f"The {label} predicts voltages with this correlation and error.",
            rules.operator_figures(name),
            "R within 0.005; MSE is not tested, since its unit is not stated",
            _OPERATORS,
            partial(rules.operator_row, name),
        )
        for name, label in (("surrogate", "learned operator"), ("jacobian", "Jacobian"))
    ),
    *(
        Claim(
            name,
            "Fig. 5",
            says,
            rules.curve_figures(columns),
            "share of the epochs after the warm-up of 30: holds from 95 % on, in part above 50 %",
            "eitbench train dnn --suite paper --operator surrogate && "
            "eitbench train phydnn --suite paper",
            partial(rules.loss_curves, columns),
        )
        for name, says, columns in (
            (
                "data-loss",
                "PhyDNN has consistently lower training and validation data losses than DNN (a).",
                ("train", "validation"),
            ),
            (
                "physical-loss",
                "PhyDNN has a consistently lower physical loss after the warm-up (b, c).",
                ("train_physical", "validation_physical"),
            ),
        )
    ),
    Claim(
        "best-beta",
        "Fig. 5 (d)",
        "The weight beta of the physical loss is best at 0.0029.",
        (rules.BETA_FIGURE,),
        "none: a search over one seed finds the luck of its trainings, and the units differ",
        "eitbench study beta --out runs/beta && eitbench reproduce --study runs/beta",
        rules.best_beta,
    ),
    *(
        Claim(
            f"table2-{name}",
            "Table II",
            f"{rules.LABELS[name]} reconstructs clean test frames this well.",
            rules.row_figures(name),
            f"{rule}: {_WITHIN}; {_INTERVALS}",
            _PAPER,
            partial(rules.table_row, name),
        )
        for name, rule in (
            ("phydnn", "as good as published or better"),
            ("dnn", "as good as published or better"),
            ("noser", "as published, neither better nor worse"),
            ("tv", "as published, neither better nor worse"),
        )
    ),
    Claim(
        "learned-over-classical",
        "Table II",
        "DNN and PhyDNN are better than NOSER and TV.",
        rules.difference_figures(
            *(f"{a} minus {b}" for a in ("DNN", "PhyDNN") for b in ("NOSER", "TV"))
        ),
        f"differences on the same samples; {_INTERVALS}",
        _PAPER,
        partial(rules.better_than, _OVER_CLASSICAL),
    ),
    Claim(
        "phydnn-over-dnn",
        "Table II",
        "The physical loss makes PhyDNN better than DNN, the same network without it.",
        rules.difference_figures("PhyDNN minus DNN"),
        f"differences on the same samples; {_INTERVALS}",
        _PAPER,
        partial(rules.better_than, _OVER_DNN),
    ),
    Claim(
        "phydnn-over-dnn-seeds",
        "Table II",
        "The physical loss makes PhyDNN better than DNN, whatever the seed of the training.",
        rules.difference_figures("PhyDNN minus DNN"),
        f"differences on the same samples, Student's intervals over the seeds; {_INTERVALS}",
        "eitbench study physics --out runs/physics && eitbench reproduce --study runs/physics",
        rules.phydnn_over_dnn_with_seeds,
    ),
    *(
        Claim(
            name,
            where,
            says,
            rules.difference_figures(
                *(f"{rules.LABELS[a]} minus {rules.LABELS[b]}" for a, b in pairs),
                metrics=rules.SHAPE_METRICS,
            ),
            f"differences on the same samples; {_INTERVALS}",
            _PAPER,
            partial(rules.better_than, pairs, metrics=rules.SHAPE_METRICS),
        )
        for name, where, says, pairs in (
            (
                "networks-cleaner",
                "Section III-E",
                "DNN and PhyDNN show sharper edges and fewer artefacts than NOSER and TV.",
                _OVER_CLASSICAL,
            ),
            (
                "phydnn-cleaner",
                "Section V",
                "The physical loss reduces artefacts and improves shapes.",
                _OVER_DNN,
            ),
        )
    ),
    Claim(
        "every-case",
        "Section III-E",
        "PhyDNN has the best of all four metrics in every case (of seven; tested as: in nearly all "
        "test samples).",
        (rules.CASES_FIGURE,),
        f"in at least 95 % of the samples; {_INTERVALS}",
        _PAPER,
        rules.every_case,
    ),
    Claim(
        "generalisation",
        "Section I",
        "The physical loss improves generalisation (tested as: PhyDNN is better than DNN on unseen "
        "shapes).",
        rules.difference_figures("PhyDNN minus DNN"),
        f"differences on the same samples; {_INTERVALS}",
        "eitbench run shapes --methods dnn,phydnn",
        partial(rules.better_than, _OVER_DNN, scenarios=("shapes",)),
    ),
    Claim(
        "noise-robustness",
        "Section V",
        "The physical loss improves robustness to noise (tested as: PhyDNN is better than DNN at "
        "all levels).",
        rules.difference_figures(*(f"PhyDNN minus DNN on {name}" for name in _RANGES)),
        f"differences on the same samples; {_INTERVALS}",
        "eitbench run noise --methods dnn,phydnn",
        partial(rules.better_than, _OVER_DNN, scenarios=_RANGES),
    ),
    Claim(
        "frame-rate",
        "Section II-A",
        "The networks reconstruct 10 frames per second.",
        rules.RATES,
        "at least 10 frames per second at the 99th percentile of single warm frames",
        _PAPER,
        rules.frame_rate,
    ),
    Claim(
        "real-presses",
        "Section IV",
        "The physical loss improves reconstructions of real measurements.",
        (rules.PLACE_FIGURE,),
        f"median difference of place errors on the same presses; {_INTERVALS}",
        "eitbench run presses --methods dnn,phydnn",
        rules.real_presses,
    ),
    Claim(
        "six-objects",
        "Section IV, cases 8 to 13",
        "PhyDNN shows six pressed objects rounder, sharper and more uniform than DNN.",
        rules.difference_figures("PhyDNN minus DNN", metrics=_OBJECT_METRICS),
        "differences on the same samples of a simulated replica, since the recordings are not "
        f"published; {_INTERVALS}",
        "eitbench run objects --methods dnn,phydnn",
        partial(rules.better_than, _OVER_DNN, scenarios=("objects",), metrics=_OBJECT_METRICS),
    ),
    Claim(
        "force",
        "Section I",
        "The physical loss significantly enhances contact-force estimation.",
        tuple(rules.FORCE_FIGURES.values()),
        "median difference of force errors on the same simulated soft presses, since the paper "
        f"has no experiment on force; {_INTERVALS}",
        "eitbench run shapes --methods dnn,phydnn && eitbench run presses --methods dnn,phydnn",
        rules.force,
    ),
)
