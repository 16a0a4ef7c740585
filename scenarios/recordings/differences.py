"""Touches as changes: their frames on one reference frame, measured or modelled."""

import numpy as np
import pandas as pd

from eitbench.scenarios.arrays import Array
from eitbench.scenarios.physics.forward import forward_model
from eitbench.scenarios.recordings.descriptors import RecordedFrames, is_validation
from eitbench.scenarios.sensors.sensor import Sensor

TYPICAL_CHANGE = 0.02
"""What a touch changes of the frame, where nothing but the change is known: that of a press on the
hydrogel discs `ohmc16` and `ohmc8` is 1.8 and 2.8 % (median)."""


def rebased(pressed: Array, released: Array, samples: pd.DataFrame) -> RecordedFrames:
    """Frames (n, M) on one reference: the median of the validation presses' released frames."""
    reference = np.median(released[is_validation(samples)], axis=0)
    return RecordedFrames(reference + pressed - released, reference, samples)


def on_modelled_reference(
    differences: Array, sensor: Sensor, samples: pd.DataFrame
) -> RecordedFrames:
    """Frames of n touches from `differences` (n, M), pressed minus released.

    The reference is the model's frame of the untouched `sensor`, scaled so that the median
    validation touch changes it by `TYPICAL_CHANGE`. The real gain is unknown: methods fit theirs to
    the reference frame, so that this is the scale of their images, and no place follows from it.
    """
    model = forward_model(sensor)
    reference = model.voltages(model.background)
    change = np.median(np.linalg.norm(differences[is_validation(samples)], axis=1))
    if change > 0:
        reference = reference * change / (TYPICAL_CHANGE * np.linalg.norm(reference))
    return RecordedFrames(reference + differences, reference, samples, modelled_reference=True)
