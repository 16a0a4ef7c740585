"""Pages that are open: for each one the newest image waits until earlier ones are painted."""

import asyncio
import itertools
import time
from collections import deque
from statistics import median
from typing import NamedTuple

from eitbench.hardware.live.live_image import LiveImage, to_message
from eitbench.scenarios.sensors.sensor import Sensor

# Images that were sent and are not painted yet. Two, so that one is on its way while another is
# painted; no more, so that a slow page skips images and never shows old ones.
MOST_UNPAINTED = 2
_LATENCIES = 30


class Message(NamedTuple):
    """An encoded live image: its number, its bytes, and the time its frame was received [s]."""

    number: int
    data: bytes
    received_s: float


class Viewer:
    """One page. Belongs to the event loop's thread."""

    def __init__(self) -> None:
        self._newest: Message | None = None
        self._ready = asyncio.Event()
        self._unpainted: dict[int, float] = {}
        self._latencies: deque[float] = deque(maxlen=_LATENCIES)
        self._shown_s: float | None = None

    def offer(self, message: Message) -> None:
        """Replace the message that was not sent yet."""
        self._newest = message
        self._check()

    def painted(self, number: int) -> None:
        """Note that image `number` is on the canvas; none that was sent before it will follow."""
        if number in self._unpainted:
            self._shown_s = self._unpainted[number]
            self._latencies.append(time.monotonic() - self._shown_s)
        self._unpainted = {n: at for n, at in self._unpainted.items() if n > number}
        self._check()

    async def next(self, wait_s: float) -> Message | None:
        """Return the message to send; None if there is none within `wait_s` [s]."""
        try:
            async with asyncio.timeout(wait_s):
                await self._ready.wait()
        except TimeoutError:
            return None
        message, self._newest = self._newest, None
        self._ready.clear()
        if message is not None:
            self._unpainted[message.number] = message.received_s
        return message

    @property
    def latency_ms(self) -> float | None:
        """Median time from a frame's last byte to the canvas [ms]; None before the first."""
        return round(1e3 * median(self._latencies), 1) if self._latencies else None

    @property
    def age_s(self) -> float | None:
        """Time since the frame whose image is on the canvas [s]; None before the first."""
        return None if self._shown_s is None else round(time.monotonic() - self._shown_s, 1)

    def _check(self) -> None:
        if self._newest is not None and len(self._unpainted) < MOST_UNPAINTED:
            self._ready.set()


class Broadcast:
    """Passes live images from the thread that makes them to the viewers in the event loop.

    Attributes:
        viewers: the pages that are open; belongs to the event loop's thread.
    """

    def __init__(self, sensor: Sensor) -> None:
        self.viewers: set[Viewer] = set()
        self._sensor = sensor
        self._numbers = itertools.count(1)
        self._loop: asyncio.AbstractEventLoop | None = None

    def add(self, viewer: Viewer) -> None:
        """Let `viewer` have the live images from now on; called in the event loop."""
        self._loop = asyncio.get_running_loop()
        self.viewers.add(viewer)

    def show(self, live_image: LiveImage) -> None:
        """Offer `live_image` to every viewer; called by any thread, and never waits."""
        loop = self._loop
        if loop is None or not self.viewers:
            return
        number = next(self._numbers)
        data = to_message(live_image, number, self._sensor)
        try:
            loop.call_soon_threadsafe(
                self._offer, Message(number, data, live_image.frame.received_s)
            )
        except RuntimeError:  # the loop was closed meanwhile: no page is open any more
            self._loop = None

    def _offer(self, message: Message) -> None:
        for viewer in self.viewers:
            viewer.offer(message)
