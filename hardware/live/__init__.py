"""The live view of a board: a page in the browser with images, contacts and voltages."""

from eitbench.hardware.live.run import LiveView, live_view
from eitbench.hardware.live.server import Access, access_to

__all__ = ["Access", "LiveView", "access_to", "live_view"]
