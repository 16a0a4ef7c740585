"""The image and the contacts of one frame, and their bytes on the wire.

A message is the length of its header (uint32, little-endian), the header (JSON in UTF-8, padded
with spaces to a multiple of 4 bytes), then float32 values, little-endian: the image (H x W, NaN
outside the sensor; absent if there is none), the voltages (M) and the reference (M; absent if there
is none).
"""

import json
import struct
from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import NDArray

from eitbench.hardware.board import Frame
from eitbench.scenarios.sensors.sensor import Sensor

Array = NDArray[np.float64]


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
