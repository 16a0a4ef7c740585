"""Every parser gives back the frames that a board sends, and says why it cannot."""

import re
import struct
import zlib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from eitbench.hardware.protocols import PROTOCOLS, teensy
from eitbench.hardware.protocols.eit_kit import EitKit
from eitbench.hardware.protocols.lines import numbers
from eitbench.hardware.protocols.openeit import MARK, MODES, OpenEit
from eitbench.hardware.protocols.protocol import PATIENCE
from eitbench.hardware.protocols.sciospec import ACKNOWLEDGED, REFUSED, START, STOP, Sciospec
from eitbench.hardware.protocols.teensy import Teensy, pattern_id
from eitbench.scenarios.catalogue import sensor
from eitbench.scenarios.errors import InputError
from eitbench.scenarios.recordings import recorded_set
from eitbench.scenarios.recordings.public.jku_tank import DRIVES, read_txt
from eitbench.scenarios.sensors.patterns import in_phase_differences, offset_pattern
from eitbench.scenarios.sensors.sensor import foam16

MakeStream = Callable[..., Any]


@pytest.mark.parametrize("piece", [1, 7, 1000, 10**6])
def test_every_frame_comes_out_however_the_bytes_are_cut(
    name: str, piece: int, stream: MakeStream
) -> None:
    sent = stream(name, 5)
    parser, data = sent.parser(), b"".join(sent.messages)
    frames = []
    for at in range(0, len(data), piece):
        frames += parser.feed(data[at : at + piece], 3.5)
    assert len(frames) == 5
    assert all(sent.holds(k, frame.values) for k, frame in enumerate(frames))
    assert [frame.number for frame in frames] == [0, 1, 2, 3, 4]
    assert {frame.received_s for frame in frames} == {3.5}
    assert (parser.health.frames, parser.health.dropped, parser.health.damaged) == (5, 0, 0)


def test_boards_with_a_clock_stamp_their_frames(stream: MakeStream) -> None:
    for name in ("teensy", "sciospec"):
        sent = stream(name, 4)
        frames = sent.parser().feed(b"".join(sent.messages), 9.0)
        np.testing.assert_allclose([f.time_s for f in frames][1:], [0.1, 0.2, 0.3], atol=1e-6)


def test_without_a_clock_a_frame_has_the_time_of_its_last_byte(stream: MakeStream) -> None:
    for name in ("openeit", "eit-kit"):
        sent = stream(name, 1)
        parser = sent.parser()
        assert parser.feed(sent.messages[0][:-1], 8.0) == []
        (frame,) = parser.feed(sent.messages[0][-1:], 9.0)
        assert frame.time_s == frame.received_s == 9.0


def test_only_its_own_stream_is_recognised(name: str, stream: MakeStream) -> None:
    data = b"".join(stream(name, 3).messages)
    assert [other for other, p in PROTOCOLS.items() if p.recognises(data[100:])] == [name]


def test_a_gap_in_running_numbers_counts_as_dropped(stream: MakeStream) -> None:
    sent = stream("teensy", 9)
    parser = sent.parser()
    parser.feed(b"".join([*sent.messages[:3], *sent.messages[5:]]), 0.0)
    assert (parser.health.frames, parser.health.dropped) == (7, 2)
    # A board that was switched off and on begins again, and loses nothing.
    parser.feed(b"".join(sent.messages[:2]), 0.0)
    assert (parser.health.frames, parser.health.dropped) == (9, 2)
    # Nor does one that is paused, whose frames the host does not read meanwhile.
    parser.begin()
    parser.feed(b"".join(sent.messages[6:]), 0.0)
    assert (parser.health.frames, parser.health.dropped) == (12, 2)


def test_a_wrong_checksum_costs_that_frame_only(stream: MakeStream) -> None:
    sent = stream("teensy", 3)
    wrong = bytearray(sent.messages[1])
    wrong[400] ^= 4
    parser = sent.parser()
    frames = parser.feed(sent.messages[0] + bytes(wrong) + sent.messages[2], 0.0)
    assert [f.number for f in frames] == [0, 2]
    health = parser.health
    assert (health.damaged, health.dropped) == (1, 1)


@pytest.mark.parametrize("bits", [0x7F800001, 0x7FC00000, 0x7F800000, 0xFF800000])
def test_values_that_are_not_finite_are_no_frame(bits: int, stream: MakeStream) -> None:
    sent = stream("teensy", 1)
    raw = bytearray(sent.messages[0])
    raw[52:56] = struct.pack("<I", bits)
    raw[-4:] = struct.pack("<I", zlib.crc32(raw[:-4]))
    parser = sent.parser()
    assert parser.feed(bytes(raw), 0.0) == []
    assert parser.health.damaged == 1
    sent = stream("sciospec", 2)
    raw = bytearray(sent.messages[0])
    raw[151:155] = raw[159:163] = struct.pack(">I", bits)
    parser = sent.parser()
    (frame,) = parser.feed(bytes(raw) + sent.messages[1], 0.0)
    assert (frame.number, parser.health.damaged) == (1, 1)


def refusal(parser: Any, messages: list[bytes]) -> str:
    """Reason why `parser` refuses a board; a few frames may be left from before."""
    assert parser.feed(b"".join(messages[: PATIENCE - 1]), 0.0) == []
    assert parser.refusal is None
    assert parser.feed(b"".join(messages[PATIENCE - 1 :]), 0.0) == []
    return str(parser.refusal)


@pytest.mark.parametrize("wrong", [3e38, -1e10, np.nan])
def test_impossible_values_are_named(wrong: float) -> None:
    """As a float32 of garbage may be."""
    foam, values = foam16(), np.ones(208)
    values[7] = wrong
    parser = Teensy(foam)
    messages = [teensy.encode(parser._pattern, k, 0.0, values) for k in range(PATIENCE)]
    said = refusal(parser, messages)
    less = " V/A as value 7, where less than 1e+10 is possible"
    what = f"{wrong:.3g}{less}" if np.isfinite(wrong) else "nan as value 7, which is no number"
    assert f"impossible values, such as {what}" in said
    assert parser.health.damaged == PATIENCE


def test_a_line_of_impossible_values_is_no_frame(stream: MakeStream) -> None:
    parser = OpenEit(sensor("ohmc16"))
    (line,) = stream("openeit", 1).messages
    parser.feed(MARK + b"99999999999.0000," + line[len(MARK) + 14 :], 0.0)
    assert (parser.health.frames, parser.health.damaged) == (0, 1)


def test_a_board_with_another_pattern_is_refused(stream: MakeStream) -> None:
    four = sensor("foam16", offset=4)
    for name, says in (
        ("teensy", "drive pattern 0x944d where sensor 'foam16' has 208 of 0x3862"),
        ("eit-kit", "16 electrodes and offset 4 where sensor 'foam16' has 16 and 3"),
    ):
        sent = stream(name, 2 * PATIENCE, four)
        assert says in refusal(PROTOCOLS[name](foam16()), sent.messages)


def test_another_number_of_values_is_refused(stream: MakeStream) -> None:
    eight = replace(foam16(), electrodes=foam16().electrodes[::2], pattern=offset_pattern(8, 3))
    cases = [
        (Teensy(foam16()), sensor("ohmc16"), "192 values a frame of drive pattern"),
        (
            OpenEit(sensor("ohmc16")),
            sensor("ohmc8"),
            "32 values a frame where sensor 'ohmc16' has 192",
        ),
        (EitKit(foam16()), eight, "8 electrodes and offset 3 where sensor 'foam16' has 16 and 3"),
        (EitKit(eight), foam16(), "16 electrodes and offset 3 where sensor 'foam16' has 8 and 3"),
    ]
    for parser, other, says in cases:
        sent = stream(parser.name, 2 * PATIENCE, other)
        assert says in refusal(parser, sent.messages)


def test_lines_of_another_form_are_refused(stream: MakeStream) -> None:
    numbered = ",".join(f"{k}.0000" for k in range(1, 257)).encode() + b"\n"
    values = numbered.split(b",", 48)[-1]
    for line, says in (
        (numbered, "16 x 16 values that are not 0 on driven pairs"),
        (values, "sends 208 values a line, not 16 x 16"),
    ):
        assert says in refusal(EitKit(foam16()), [line] * PATIENCE)
    marked = [b"magnitudes: " + values] * PATIENCE
    assert "sends 208 values" in refusal(OpenEit(sensor("ohmc16")), marked)


def test_injections_of_another_pattern_are_refused(stream: MakeStream) -> None:
    sent = stream("sciospec", 3 * PATIENCE, sensor("jku-tank-adjacent"))
    parser = Sciospec(sensor("sciospec-tank"))
    for message in sent.messages:
        assert parser.feed(message, 0.0) == []
    assert "injections that are not in the pattern" in str(parser.refusal)


def test_a_refusal_ends_with_the_first_good_frame(stream: MakeStream) -> None:
    parser = Teensy(foam16())
    refusal(parser, stream("teensy", 2 * PATIENCE, sensor("foam16", offset=4)).messages)
    assert len(parser.feed(stream("teensy", 1).messages[0], 0.0)) == 1
    assert parser.refusal is None


@pytest.mark.parametrize(
    ("protocol", "other"),
    [(EitKit, "ohmc16"), (OpenEit, "foam16"), (Sciospec, "ktc2023"), (EitKit, "pyeidors-tank")],
)
def test_a_sensor_that_a_board_cannot_measure_is_refused(protocol: Any, other: str) -> None:
    with pytest.raises(InputError, match=other):
        protocol(sensor(other))


# teensy


def test_the_documented_bytes_are_the_frame() -> None:
    text = (Path(__file__).parents[3] / "docs/teensy-protocol.md").read_text()
    listing = text.split("```text\n")[1].split("```")[0]
    example = bytes.fromhex("".join(re.findall(r"^([0-9a-f ]+?)(?:  .*)?$", listing, re.M)))
    square = replace(foam16(), electrodes=foam16().electrodes[::4], pattern=offset_pattern(4, 1))
    assert f"{pattern_id(square.pattern):#06x}" in text
    (frame,) = Teensy(square).feed(example, 1.0)
    assert (frame.number, frame.time_s) == (258, 12.345678)
    np.testing.assert_array_equal(frame.values, [0.25, -0.5, 1.0, -2.0])
    assert teensy.encode(pattern_id(square.pattern), 258, 12.345678, frame.values) == example


# eit-kit


def matrix_text(values: np.ndarray, mark: str, n: int = 16) -> bytes:
    matrix = np.zeros((n, n))
    table = offset_pattern(n, 3).table
    matrix[table[:, 0], table[:, 2]] = values
    return (mark + ",".join(f"{v:.4f}" for v in matrix.ravel()) + "\r\n").encode()


def test_marked_lines_are_frames_and_the_boards_own_reference_is_none(stream: MakeStream) -> None:
    sent = stream("eit-kit", 3)
    parser = sent.parser()
    lines = [
        b"EIT-kit, 16 electrodes\r\n",
        matrix_text(sent.values[0], "ORIGIN_DATA,"),
        b"calibrated, 0, 1, 2\r\n",
        matrix_text(sent.values[1], "FRAME_DATA,"),
        matrix_text(sent.values[2], "frame: FRAME_DATA,"),
    ]
    frames = parser.feed(b"".join(lines), 0.0)
    assert len(frames) == 2
    assert sent.holds(1, frames[0].values)
    assert sent.holds(2, frames[1].values)
    assert parser.health.damaged == 0


def test_row_is_drive_and_column_is_sense() -> None:
    matrix = np.arange(256.0).reshape(16, 16)
    matrix[EitKit(foam16())._zeros] = 0
    line = ", ".join(f"{v:.4f}" for v in matrix.ravel()) + ", \n"
    (frame,) = EitKit(foam16()).feed(line.encode(), 0.0)
    for value, (src, _, a, _) in zip(frame.values, foam16().pattern.table.tolist(), strict=True):
        assert value == 16 * src + a


# openeit


def test_values_keep_their_order() -> None:
    nominal = sensor(OpenEit.default_sensor)
    text = b"magnitudes: " + b"".join(b"%8d.%04d," % (k, k) for k in range(192)) + b"\r\n"
    (frame,) = OpenEit(nominal).feed(text, 0.0)
    np.testing.assert_allclose(frame.values, np.arange(192) * 1.0001)


def test_the_letter_sets_the_number_of_electrodes(stream: MakeStream) -> None:
    nominal = sensor("ohmc16")
    assert OpenEit(nominal).starting() == (b"d\n",)
    device = OpenEit.device(nominal)
    assert device.running
    assert device.encode(0, 0.0, np.ones(192)) == b"magnitudes: " + 32 * b"       0.0000," + b"\r\n"
    device.obey(MODES[16])
    device.obey(b"\r\n")
    assert device.encode(0, 0.0, np.ones(192)).count(b"1000.0000,") == 192


def test_an_emulated_board_measures_with_the_electrodes_it_has(stream: MakeStream) -> None:
    device, host = OpenEit.device(sensor("ohmc16")), OpenEit(sensor("ohmc8"))
    for command in host.starting():
        device.obey(command)
    for k in range(PATIENCE):
        assert host.feed(device.encode(k, 0.0, np.ones(192)), 0.0) == []
    assert host.refusal is not None
    assert "sends 192 values a frame where sensor 'ohmc8' has 32" in host.refusal


def test_a_line_that_lost_its_beginning_is_a_damaged_frame(stream: MakeStream) -> None:
    sent = stream("openeit", 5)
    parser = sent.parser()
    data = sent.messages[0] + sent.messages[1] + sent.messages[2][5:] + sent.messages[3]
    frames = parser.feed(data, 0.0)
    assert [frame.number for frame in frames] == [0, 1, 3]
    assert parser.health.damaged == 1
    parser.begin()  # what comes first may be the end of a line
    assert len(parser.feed(sent.messages[3][40:] + sent.messages[4], 0.0)) == 1
    assert parser.health.damaged == 1


# sciospec


def results(sent: Any, k: int) -> list[bytes]:
    return [sent.messages[k][at : at + 140] for at in range(0, len(sent.messages[k]), 140)]


def test_setting_up_sends_every_injection_and_waits_for_its_acknowledgement() -> None:
    nominal = sensor("sciospec-tank")
    device, commands = Sciospec.device(nominal), Sciospec(nominal).starting()
    assert commands[0] == bytes([0xB0, 3, 6, 1, 4, 0xB0])
    assert commands[-1] == START
    parser = Sciospec(nominal)
    for command in commands:
        parser.feed(device.obey(command), 0.0)
    assert parser.answers == [True] * 17
    assert device.running
    assert device.obey(STOP + bytes([0xB0, 3, 6, 1, 9, 0xB0])) == ACKNOWLEDGED + REFUSED
    assert not device.running


@pytest.mark.parametrize("wrong", ["missing", "swapped", "unknown", "cut"])
def test_a_wrong_result_costs_its_frame_only(wrong: str, stream: MakeStream) -> None:
    sent = stream("sciospec", 4)
    bad = results(sent, 1)
    if wrong == "missing":
        del bad[5]
    elif wrong == "swapped":
        bad[3], bad[4] = bad[4], bad[3]
    elif wrong == "unknown":
        bad[8] = bad[8][:3] + bytes([1, 9]) + bad[8][5:]
    else:
        bad[6] = bad[6][:77]
    data = sent.messages[0] + b"".join(bad) + sent.messages[2] + sent.messages[3]
    parser = sent.parser()
    frames = parser.feed(data, 0.0)
    assert len(frames) == 3
    assert all(sent.holds(k, f.values) for k, f in zip((0, 2, 3), frames, strict=True))
    assert [frame.number for frame in frames] == [0, 2, 3]
    assert parser.health.damaged == 1


@pytest.mark.parametrize("piece", [1, 139, 10**6])
@pytest.mark.parametrize("lost", [[0], [0, 1, 2], [15], [7]])
def test_a_frame_without_some_results_is_counted_whichever_they_are(
    lost: list[int], piece: int, stream: MakeStream
) -> None:
    sent = stream("sciospec", 6)
    messages = list(sent.messages)
    for k in (1, 3):
        messages[k] = b"".join(raw for of, raw in enumerate(results(sent, k)) if of not in lost)
    data = b"".join(messages)
    parser = sent.parser()
    frames = []
    for at in range(0, len(data), piece):
        frames += parser.feed(data[at : at + piece], 0.0)
    assert [frame.number for frame in frames] == [0, 2, 4, 5]
    assert parser.health.damaged == 2
    # Behind a pause the end of a frame is no loss.
    parser.begin()
    parser.feed(b"".join(results(sent, 0)[9:]) + sent.messages[5], 0.0)
    assert parser.health.damaged == 2


def test_frames_that_all_lack_their_first_result_are_counted(stream: MakeStream) -> None:
    sent = stream("sciospec", 20)
    parser = sent.parser()
    assert parser.feed(b"".join(b"".join(results(sent, k)[1:]) for k in range(20)), 0.0) == []
    assert parser.health.damaged == 19  # the first may be one that began before


def test_other_frequencies_and_answers_may_stand_between(stream: MakeStream) -> None:
    sent = stream("sciospec", 1)
    other = [raw[:5] + bytes([0, 1]) + raw[7:] for raw in results(sent, 0)]
    mixed = [part for pair in zip(results(sent, 0), other, strict=True) for part in pair]
    parser = sent.parser()
    (frame,) = parser.feed(ACKNOWLEDGED.join(mixed), 0.0)
    assert sent.holds(0, frame.values)


@pytest.mark.parametrize("drive", DRIVES)
def test_real_bytes_give_the_voltages_of_the_recorded_set(drive: str, recorded_data: Path) -> None:
    recorded = recorded_set(f"jku-tank-{drive}")
    nominal = recorded.sensor()
    for file in recorded.files:
        path = recorded_data / recorded.repository / file.path
        header, *lines = path.read_text().splitlines()
        current = float(header.split(",")[0].removeprefix("Current:"))
        raw = b"".join(b"\xb4\x89" + bytes.fromhex(x) + b"\xb4" for x in lines if x.strip())
        (frame,) = Sciospec(nominal).feed(raw, 0.0)
        expected = in_phase_differences(read_txt(path), DRIVES[drive], nominal.pattern)
        np.testing.assert_allclose(frame.values / current, expected, rtol=1e-12, atol=1e-12)


# numbers


@given(
    st.lists(st.decimals(-99999, 99999, places=4), min_size=1, max_size=30),
    st.sampled_from([",", ", ", " ,\t", ",      "]),
    st.sampled_from(["", ",", ", "]),
)
def test_numbers_are_those_that_python_reads(values: list[Any], separator: str, end: str) -> None:
    text = separator.join(map(str, values)) + end
    np.testing.assert_array_equal(numbers(text.encode()), [float(v) for v in values])


@pytest.mark.parametrize(
    "text", ["", "1,,2", "1 2", "1.2.3", "--1", "1-2", "nan", "1e5", "0x1", "1_0", "-", ".", "1,;"]
)
def test_anything_else_is_no_number(text: str) -> None:
    assert len(numbers(text.encode())) == 0
