"""File names that any system takes, one for each text."""

import hashlib
import re
from urllib.parse import quote

MAX_LENGTH = 120
"""Longest file name [bytes]: file systems take 255, and suffixes may follow."""

# Names of devices on Windows, whatever follows a dot.
_DEVICE = re.compile(r"(?:con|prn|aux|nul|com\d|lpt\d)(?:\.|$)", re.IGNORECASE)


def file_name(text: str) -> str:
    """Return `text` as one file name: no path, no device, and unlike others in more than case."""
    if not text:
        return "%"
    # A ~ stands before digests only.
    name = quote(text, safe="").replace("~", "%7E")
    if len(name) > MAX_LENGTH or re.search("[A-Z]", text):
        digest = hashlib.sha256(text.encode()).hexdigest()[:16]
        name = f"{name[: MAX_LENGTH - 17]}~{digest}"
    if name[0] == "." or _DEVICE.match(name):
        name = _encoded(name[0]) + name[1:]
    # Windows leaves out a dot at the end.
    return name[:-1] + _encoded(".") if name[-1] == "." else name


def _encoded(character: str) -> str:
    return f"%{ord(character):02X}"
