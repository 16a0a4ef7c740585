"""Figures drawn with Matplotlib, which is loaded when one is drawn."""

from eitbench.reports.figures.image_grid import write_figures
from eitbench.reports.figures.ladder import write_ladder
from eitbench.reports.figures.losses import write_losses

__all__ = ["write_figures", "write_ladder", "write_losses"]
