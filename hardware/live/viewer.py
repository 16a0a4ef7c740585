"""Live images, their bytes on the wire, and the open pages that they are offered to.

A message is the length of its header (uint32, little-endian), the header (JSON in UTF-8, padded
with spaces to a multiple of 4 bytes), then float32 values, little-endian: the image (H x W, NaN
outside the sensor; absent if there is none), the voltages (M) and the reference (M; absent if there
is none). For each page the newest image waits until earlier ones are painted.
"""

import asyncio
import itertools
import json
import struct
import time
from collections import deque
from dataclasses import asdict, dataclass
from statistics import median
from typing import NamedTuple

import numpy as np

from eitbench.hardware.board import Frame
from eitbench.scenarios.arrays import Array
from eitbench.scenarios.sensors.sensor import Sensor


@dataclass(frozen=True)
class Contact:
    """A contact that an image shows.

    Attributes:
        x_m, y_m: its centroid in the sensor's frame [m].
        strength: |contrast| integrated over it [S/m * m^2].
        area_m2: [m^2].
    """

    x_m: float
    y_m: float
    strength: float
    area_m2: float


@dataclass(frozen=True, eq=False)
class LiveImage:
    """The image of one frame and the contacts in it.

    Attributes:
        frame: the frame.
        method: name of the method that made the image; "" if none is ready.
        image: (H, W) absolute conductivity [S/m]; None without a method or a reference, and where
            the method failed.
        reference: (M,) the reference frame in the board's units; None if there is none yet.
        contacts: the strongest first.
        failed: reason why the method made no image of this frame; "" if it did.
        image_ms: computing time of the image [ms].
    """

    frame: Frame
    method: str
    image: Array | None
    reference: Array | None
    contacts: tuple[Contact, ...]
    failed: str
    image_ms: float


def to_message(live_image: LiveImage, number: int, sensor: Sensor) -> bytes:
    """Encode the `number`-th live image as a message."""
    header = {
        "number": number,
        "frame": live_image.frame.number,
        "method": live_image.method,
        "shape": None if live_image.image is None else list(sensor.image_shape),
        "values": len(live_image.frame.values),
        "reference": live_image.reference is not None,
        "contacts": [asdict(contact) for contact in live_image.contacts],
        "failed": live_image.failed,
        "image_ms": round(live_image.image_ms, 3),
    }
    text = json.dumps(header, allow_nan=False).encode()
    text += b" " * (-len(text) % 4)
    parts = [struct.pack("<I", len(text)), text]
    if live_image.image is not None:
        parts.append(np.where(sensor.mask, live_image.image, np.nan).astype("<f4").tobytes())
    parts.append(live_image.frame.values.astype("<f4").tobytes())
    if live_image.reference is not None:
        parts.append(live_image.reference.astype("<f4").tobytes())
    return b"".join(parts)


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
