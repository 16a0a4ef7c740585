"""A skin that drifts, pressed at known places, as frames before and during each press."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from eitbench.hardware.recording.exchange import write_recording
from eitbench.scenarios import forward_model, sensor
from eitbench.scenarios.phantoms.press import FOAM
from eitbench.scenarios.recordings.files.pairs import from_pairs
from eitbench.scenarios.sensors.outlines import rectangle
from eitbench.scenarios.sensors.sensor import Sensor, even_electrodes

Array = NDArray[np.float64]
OUTLINE = rectangle(0.1, 0.08)  # no square, so that electrodes numbered anew are told
SKIN = Sensor(
    "bench",
    OUTLINE,
    even_electrodes(OUTLINE, 16, 0.008, 1e-3, start=0.0125),
    sensor("foam16").pattern,
    image_shape=(20, 24),
    conductivity_range=(0.05, 1.0),
)


def pressed_skin(
    n: int, *, drift: float = 0.0, rising: int = 0, skin: Sensor = SKIN
) -> tuple[Array, Array, pd.DataFrame]:
    """Released and pressed frames (n, M), and the places; the first `rising` raise conductivity."""
    model, draws = forward_model(skin), np.random.default_rng(4)
    x, y = skin.pixel_centres
    places = draws.uniform(0.015, 0.065, size=(n, 2))
    away = np.hypot(x - places[:, :1, None], y - places[:, 1:, None])
    change = FOAM.pressed(40e3, np.maximum(away - 0.005, 0))
    change[:rising] = 1 / change[:rising]
    # A warm corner wanders through the skin, as on the hydrogels: no gain removes it.
    warm = 1 + drift * np.linspace(0, 1, n)[:, None, None] * (x > 0.05) * (y > 0.04)
    background = warm * model.background
    frames = model.voltages(np.concatenate([background, background * change]))
    # Channels 1 % uneven, and noise.
    frames = frames * (1 + 0.01 * draws.normal(size=frames.shape[1]))
    frames = frames + 1e-4 * np.std(frames[0]) * draws.normal(size=frames.shape)
    return frames[:n], frames[n:], pd.DataFrame(places, columns=["x_m", "y_m"])


def renumbered(skin: Sensor, number: NDArray[np.int64]) -> Sensor:
    """The sensor whose electrode k is the electrode `number[k]` of `skin`."""
    return replace(skin, electrodes=tuple(skin.electrodes[k] for k in number.tolist()))


def recording(path: Path, n: int = 50, skin: Sensor = SKIN, *contacts: dict[str, float]) -> str:
    """A recording of one's own of `n` touches."""
    released, pressed, places = pressed_skin(n, skin=skin)
    labels = places.assign(touch=range(n))
    if contacts:
        labels = pd.concat([labels, pd.DataFrame(contacts)])
    write_recording(from_pairs(released, pressed, skin, "fake", labels), path)
    return str(path)


def rows(table: Array) -> set[bytes]:
    """The rows of a table, to be compared bit for bit."""
    return {row.tobytes() for row in np.ascontiguousarray(table)}
