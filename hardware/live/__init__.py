"""The live view of a board: a page in the browser with images, contacts and voltages."""

from eitbench.hardware.live.access import Access, access_to
from eitbench.hardware.live.run import LiveView, live_view

__all__ = ["Access", "LiveView", "access_to", "live_view"]
