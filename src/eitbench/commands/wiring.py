"""The doctor of wiring, from a file of frames to its page and sensor file."""

from pathlib import Path


def examine(source: str, name: str | None, known: Path | None, out: Path) -> tuple[list[str], bool]:
    """Examine frames; write `doctor.html`, and `sensor.toml` where there is an answer.

    Returns:
        Sentences, and whether there is an answer.

    Raises:
        EitbenchError: frames or a sensor that cannot be read, or do not belong together.
    """
    from eitbench.hardware.recording.importing.unordered import labelled_touches, unordered_frames
    from eitbench.reports.figures.wiring import WiringFrames
    from eitbench.reports.page.wiring import write_wiring_page
    from eitbench.scenarios.catalogue import sensor as sensor_by_name
    from eitbench.scenarios.errors import InputError
    from eitbench.scenarios.recordings.fetch import read_recording
    from eitbench.scenarios.recordings.registry import RECORDED_SETS
    from eitbench.scenarios.sensors.sensor_file import sensor_to_toml
    from eitbench.scenarios.storage.atomic_write import atomic_write
    from eitbench.scenarios.wiring.diagnosis import declared_frame, diagnose
    from eitbench.scenarios.wiring.evidence import known_values
    from eitbench.scenarios.wiring.hypotheses import orders
    from eitbench.scenarios.wiring.report import corrected, findings
    from eitbench.scenarios.wiring.touches import touches_of

    if name is None and source not in RECORDED_SETS:
        raise InputError("--sensor is missing: name the sensor that the frames belong to.")
    nominal = sensor_by_name(name or source)
    lengths = {len(order.table) for order in orders(nominal.pattern)}
    if source in RECORDED_SETS:
        recording = read_recording(source)
        if recording.modelled_reference:
            raise InputError(
                f"Of {source!r} only differences were measured: the doctor needs whole frames."
            )
        frames = recording.reference[None]
        touches = touches_of(recording)
    else:
        frames = unordered_frames(Path(source), lengths)
        touches = labelled_touches(Path(source))
    expected = None
    if known is not None:
        right = unordered_frames(known, {nominal.n_measurements})
        expected = known_values(right, nominal)
    found = diagnose(frames, nominal, expected, touches)
    said = findings(found, nominal)
    answered = found.certainty != "refused"
    page = out / "doctor.html"
    shown = WiringFrames(
        found.measured, declared_frame(found, nominal, expected), found.modelled,
        found.declared_misfit, found.misfit, nominal.name, not answered, found.noise,
    )  # fmt: skip
    write_wiring_page(page, f"Wiring of {Path(source).name} on {nominal.name}", said, shown)
    if answered:
        text = sensor_to_toml(corrected(found, nominal), said)
        atomic_write(out / "sensor.toml", text.encode())
        said = [*said, f"{out / 'sensor.toml'} is the corrected sensor, {page} shows it."]
    return said, answered
