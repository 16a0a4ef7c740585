"""Metrics of images, contacts and forward operators; their statistics and aggregation."""

from typing import TYPE_CHECKING

from eitbench.scenarios.lazy import lazy_names

if TYPE_CHECKING:
    from eitbench.benchmark.metrics.aggregation import aggregate
    from eitbench.benchmark.metrics.evaluation import evaluate, fit_registration
    from eitbench.benchmark.metrics.image_metrics import cc, image_figures, psnr, rie, ssim
    from eitbench.benchmark.metrics.metric_spec import MetricSpec
    from eitbench.benchmark.metrics.operator_metrics import OPERATOR_METRICS
    from eitbench.benchmark.metrics.scores import bounded_score, score
    from eitbench.benchmark.metrics.specs import METRICS

__all__ = [
    "METRICS",
    "OPERATOR_METRICS",
    "MetricSpec",
    "aggregate",
    "bounded_score",
    "cc",
    "evaluate",
    "fit_registration",
    "image_figures",
    "psnr",
    "rie",
    "score",
    "ssim",
]

# Evaluation loads pandas, which those who want a number of an image alone do not need.
__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "METRICS": "specs",
        "OPERATOR_METRICS": "operator_metrics",
        "MetricSpec": "metric_spec",
        "aggregate": "aggregation",
        "bounded_score": "scores",
        "cc": "image_metrics",
        "evaluate": "evaluation",
        "fit_registration": "evaluation",
        "image_figures": "image_metrics",
        "psnr": "image_metrics",
        "rie": "image_metrics",
        "score": "scores",
        "ssim": "image_metrics",
    },
)
