"""The page: one HTML document with its style and script inside, which fetches nothing."""

import base64
import hashlib
import json
from dataclasses import dataclass
from functools import cache
from importlib.resources import files


@dataclass(frozen=True)
class Page:
    """The answer to a request of `/`.

    Attributes:
        html: the document.
        policy: its Content-Security-Policy, which lets this style and this script run, and none
            other.
    """

    html: str
    policy: str


@cache
def page() -> Page:
    """The page of the live view."""
    folder = files("eitbench.hardware.live") / "templates"
    html = (folder / "live.html").read_text(encoding="utf-8")
    hashes = {}
    for name in ("live.css", "drawing.js", "live.js"):
        source = (folder / name).read_text(encoding="utf-8")
        html = html.replace(f"{{{{ {name} }}}}", source)
        hashes[name] = _hash(source)
    return Page(
        html.replace("{{ colours }}", json.dumps(_colours())),
        f"default-src 'none'; script-src '{hashes['drawing.js']}' '{hashes['live.js']}'; "
        f"style-src '{hashes['live.css']}'; connect-src 'self'; img-src data:; base-uri 'none'; "
        "form-action 'none'; frame-ancestors 'none'",
    )


def _hash(source: str) -> str:
    digest = hashlib.sha256(source.encode()).digest()
    return f"sha256-{base64.b64encode(digest).decode()}"


def _colours() -> list[list[int]]:
    """viridis, dark for high conductivity: even to colour-blind eyes, with touches bright."""
    from matplotlib import colormaps

    table = colormaps["viridis_r"](range(256), bytes=True)
    rows: list[list[int]] = table[:, :3].tolist()
    return rows
