"""Fingerprints of samples, by which training sets are compared with test splits."""

import hashlib
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from eitbench.scenarios.phantoms.phantom import Phantom

Contents = NDArray[np.uint64]
"""(n,): the first 64 bits of a SHA-256 for each sample."""


def contents(phantoms: Sequence[Phantom], voltages: NDArray[np.float64] | None) -> Contents:
    """Return the fingerprint of each sample: of its simulated phantom, or of its recorded frame.

    A simulated sample is the same touch whatever its noise, its mesh and the name of its split or
    scenario; of a recorded one only the frame is known.

    Args:
        phantoms: of simulated samples; empty for recorded ones.
        voltages: (n, M) recorded frames; not looked at where there are phantoms.
    """
    frames = () if voltages is None else voltages
    texts = [_text(phantom) for phantom in phantoms] or [frame.tobytes() for frame in frames]
    digests = b"".join(hashlib.sha256(text).digest()[:8] for text in texts)
    return np.frombuffer(digests, dtype="<u8").astype(np.uint64)


def _text(phantom: Phantom) -> bytes:
    # Regions and patches are values, whose representation holds every number in full.
    return repr((phantom.background, phantom.inclusions)).encode()
