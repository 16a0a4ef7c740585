"""What the doctor says, in sentences, and the sensor that it corrects."""

from dataclasses import replace

import numpy as np

from eitbench.scenarios.sensors.sensor import Sensor
from eitbench.scenarios.wiring.diagnosis import Diagnosis


def findings(found: Diagnosis, sensor: Sensor) -> list[str]:
    """One sentence on each thing that was looked for, the certainty first."""
    if found.certainty == "refused":
        return [f"Refused. {found.reason}", *_frames(found)]
    wiring = found.wiring
    touched = ""
    if np.isfinite(found.similarity):
        touched = (
            f" Touches decide: they resemble the model's with a cosine of {found.similarity:.2f}."
        )
    direction = "as declared" if wiring.step > 0 else "the other way round"
    said = [
        f"{found.certainty.capitalize()}: misfit {found.misfit:.1%}, of the best other answer "
        f"{found.runner_up:.1%}"
        + (
            f", of sensor {sensor.name!r} as declared {found.declared_misfit:.1%}."
            if np.isfinite(found.declared_misfit)
            else "."
        )
        + touched
    ]
    if found.reason:
        said.append(found.reason)
    else:
        said.append(
            f"Electrode 0 of the board is electrode {wiring.start} of the sensor, and the numbers "
            f"go {direction}."
        )
    said.append(f"Order of the values: {found.order.title}.")
    if found.pattern.magnitudes:
        said.append("The values are magnitudes, without their sign.")
    elif found.reversed_sign:
        said.append("The sign of every value is reversed: src and sink, or a and b, are swapped.")
    else:
        said.append("The values are signed, as declared.")
    if wiring.swapped:
        first, second = wiring.swapped
        said.append(f"The board's electrodes {first} and {second} are interchanged.")
    if found.dead:
        said.append(f"No contact: electrode {', '.join(map(str, found.dead))} of the sensor.")
    if found.never_alone:
        said.append(
            f"Electrode {', '.join(map(str, found.never_alone))} has no value without these: it "
            "may have no contact either, and if they have none without it, instead of them."
        )
    if found.saturated:
        said.append(f"Saturated: value {', '.join(map(str, found.saturated))}.")
    said.append(f"Gain over the model: {found.gain:.4g}.")
    if np.isfinite(found.leak):
        said.append(f"Common-mode voltage in the values: {found.leak:.2%}.")
    return [*said, *_frames(found)]


def _frames(found: Diagnosis) -> list[str]:
    if not np.isfinite(found.noise).all():
        return ["One frame says nothing of noise, drift and repeatability: give ten."]
    noisiest = np.argsort(found.noise)[:-4:-1].tolist()
    typical = float(np.median(found.noise))
    loud = ", ".join(f"{k} ({found.noise[k] / typical:.1f} times)" for k in noisiest if typical > 0)
    return [
        f"Noise: SNR {found.snr_db:.1f} dB; a value repeats within {found.repeatability:.2%} "
        f"(median); drift over the frames {found.drift:.2%}."
        + (f" The noisiest values, beside the median one: {loud}." if loud else "")
    ]


def corrected(found: Diagnosis, sensor: Sensor) -> Sensor:
    """`sensor` as the frames show it, with its electrodes in the order of the board's numbers.

    Boards read a pattern in their own numbers: were only the pattern corrected, a board would be
    told to drive other electrodes.
    """
    numbers = found.wiring.numbers(len(sensor.electrodes))
    of_board = np.argsort(numbers)
    return replace(
        sensor,
        name=f"{sensor.name}-corrected",
        electrodes=tuple(sensor.electrodes[k] for k in numbers.tolist()),
        pattern=replace(found.pattern, table=of_board[found.pattern.table]),
    )
