"""The page: one HTML document with its style and script inside, and the first message to it."""

import base64
import hashlib
import json
from functools import cache
from importlib.resources import files

import numpy as np

from eitbench.hardware.live.imaging import usable_methods
from eitbench.hardware.live.session import Session
from eitbench.scenarios.sensors.sensor import Sensor


@cache
def page() -> tuple[str, str]:
    """The page of the live view, and its Content-Security-Policy.

    The policy lets this style and this script run, and none other.
    """
    folder = files("eitbench.hardware.live") / "templates"
    html = (folder / "live.html").read_text(encoding="utf-8")
    hashes = {}
    for name in ("live.css", "drawing.js", "live.js"):
        source = (folder / name).read_text(encoding="utf-8")
        html = html.replace(f"{{{{ {name} }}}}", source)
        hashes[name] = _hash(source)
    return (
        html.replace("{{ colours }}", json.dumps(_colours())),
        f"default-src 'none'; script-src '{hashes['drawing.js']}' '{hashes['live.js']}'; "
        f"style-src '{hashes['live.css']}'; connect-src 'self'; img-src data:; base-uri 'none'; "
        "form-action 'none'; frame-ancestors 'none'",
    )


def _hash(source: str) -> str:
    digest = hashlib.sha256(source.encode()).digest()
    return f"sha256-{base64.b64encode(digest).decode()}"


def _colours() -> list[list[int]]:
    """viridis, as in all figures (`reports/figures/style.py`): even to colour-blind eyes."""
    from matplotlib import colormaps

    table = colormaps["viridis"](range(256), bytes=True)
    rows: list[list[int]] = table[:, :3].tolist()
    return rows


# A range that reaches far above the background would leave a touch a sliver of the scale.
MOST_ABOVE = 2.0
_RIM_POINTS = 256
_ELECTRODE_POINTS = 5
PRESSURES_PA = {"light": 5e3, "medium": 20e3, "hard": 60e3}


def page_setup(session: Session) -> dict[str, object]:
    """Return the first message to a page, as plain values."""
    sensor = session.board.sensor
    return {
        "board": session.name,
        "sensor": sensor.name,
        "bounds_m": list(sensor.outline.bounds),
        "outline_m": _outline(sensor),
        "electrodes_m": _electrodes(sensor),
        "background": sensor.background,
        "scale": colour_range(sensor),
        "methods": [
            {"name": name, "about": about} for name, about in usable_methods(sensor).items()
        ],
        "emulated": session.board.emulated,
        # A fingertip, if the sensor is 10 cm wide. Without pressures the sensor is real: the place
        # of a touch goes into the recording only.
        "touch": {
            "radius_m": 0.08 * sensor.outline.shorter_side,
            "pressures_pa": PRESSURES_PA if session.board.can_be_pressed else {},
        },
    }


def colour_range(sensor: Sensor) -> list[float]:
    """Least and greatest conductivity [S/m] of the fixed colour scale."""
    low, high = sensor.conductivity_range
    return [low * sensor.background, min(high, MOST_ABOVE) * sensor.background]


def _outline(sensor: Sensor) -> list[list[float]]:
    outline = sensor.outline
    around = np.linspace(0.0, outline.perimeter, _RIM_POINTS, endpoint=False)
    points: list[list[float]] = outline.point(
        np.unique(np.concatenate([around, outline.corners]))
    ).tolist()
    return points


def _electrodes(sensor: Sensor) -> list[list[list[float]]]:
    """Points along each electrode [m]."""
    lines: list[list[list[float]]] = [
        sensor.outline.point(
            np.linspace(e.centre - e.width / 2, e.centre + e.width / 2, _ELECTRODE_POINTS)
        ).tolist()
        for e in sensor.electrodes
    ]
    return lines
