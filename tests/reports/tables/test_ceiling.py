"""The line of the ceiling below a board, read from the record of its frames."""

from eitbench.benchmark.ceiling.record import recorded_frames
from eitbench.reports.tables.ceiling import ceiling_notes, ceiling_rows
from eitbench.scenarios.suites.suite import load_suite


def test_a_limited_board_has_the_ceiling_of_its_own_frames() -> None:
    scenario = next(s for s in load_suite("noise").scenarios if s.name == "noise-50db")
    row = {"method": "noser", "scenario": scenario.name, "data_hash": scenario.data_hash("test")}
    frames = recorded_frames(scenario.name, row["data_hash"])
    for count in (12, len(frames)):
        board = [{**row, "data_n": count}]
        (ceiling,) = ceiling_rows(board)
        own = frames[frames["sample"] < count]
        assert 0 < ceiling["n"] == len(own) <= count
        assert ceiling["psnr"] == own["psnr"].mean()
        assert f"the posterior mean of {len(own)} of the frames" in ceiling_notes(board)[0]
    assert ceiling_rows([{**row, "data_n": 12, "data_hash": "another"}]) == []
