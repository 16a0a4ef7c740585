"""Metrics of images, contacts and forward operators; their statistics and aggregation."""

from eitbench.benchmark.metrics.image_metrics import cc, image_figures, psnr, rie, ssim
from eitbench.benchmark.metrics.metric_spec import MetricSpec
from eitbench.benchmark.metrics.specs import METRICS

__all__ = ["METRICS", "MetricSpec", "cc", "image_figures", "psnr", "rie", "ssim"]
