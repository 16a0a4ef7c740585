"""Metrics of images, contacts and forward operators; their statistics and aggregation."""

from eitbench.benchmark.metrics.aggregation import aggregate
from eitbench.benchmark.metrics.evaluation import evaluate, fit_registration
from eitbench.benchmark.metrics.image_metrics import cc, image_figures, psnr, rie, ssim
from eitbench.benchmark.metrics.metric_spec import MetricSpec
from eitbench.benchmark.metrics.operator_metrics import OPERATOR_METRICS
from eitbench.benchmark.metrics.specs import METRICS, bounded_score, score

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
