"""Packaged suites, suite files, and the errors of bad ones."""

from pathlib import Path

import pytest
from tests.support.families import OBJECT_FAMILIES, PUBLISHED_FAMILIES, TANK_FAMILIES

from eitbench.benchmark.metrics import image_metrics
from eitbench.scenarios.data.datasets import load
from eitbench.scenarios.data.simulation import phantom
from eitbench.scenarios.errors import InputError
from eitbench.scenarios.imperfections.imperfections import Imperfections
from eitbench.scenarios.phantoms.families import FAMILIES
from eitbench.scenarios.sensors.sensor import content_hash
from eitbench.scenarios.suites.scenario import (
    RecordedScenario,
    SimulatedScenario,
    SplitNoise,
    TransferScenario,
)
from eitbench.scenarios.suites.suite import (
    WINDOW,
    Suite,
    _short_names,
    drawn_with,
    load_suite,
    on_sensor,
    read_suite,
    scenario_by_name,
    scenarios,
    suites,
)

GOOD = """\
name = "mine"
title = "My suite"
methods = ["noser"]

[[scenarios]]
kind = "simulated"
name = "first"
families = ["circle"]
train = 0
validation = 6
test = 6

[[scenarios]]
kind = "simulated"
name = "second"
families = ["circle", "ring"]
train = 0
validation = 6
test = 6
noise = { test = 50 }
"""


RECORDED = """\
name = "r"
title = "r"
methods = ["noser"]
[[scenarios]]
kind = "recorded"
name = "r"
recording = "ohmc16"
"""


SECOND = 'name = "second"\nfamiliar = '
SLIT = (
    '{ name = "slit", shape = "rectangle", sizes = { width = [0.4, 0.5], height = [0.05, 0.06] }, '
    "conductivity = [0.2, 0.5], count = 2, gap = 0.05 }]"
)
SHAPE, SIZES = "scenarios[1].families[1].shape", "scenarios[1].families[1].sizes"


def simulated(suite: str) -> list[SimulatedScenario]:
    return [s for s in load_suite(suite).scenarios if isinstance(s, SimulatedScenario)]


def test_packaged_suites_are_these() -> None:
    methods = {"quick", "paper", "paper-noise", "noise", "shapes", "presses", "recorded"}
    methods |= {
        "imperfect",
        "imperfect-presses",
        "sim2real",
        "objects",
        "tank",
        "ktc2023",
        "skins",
        "drift",
        "two-touch",
        "acuity",
        "per-frame",
        "novelty",
    }
    places = {"new-skin", "few-presses"}
    assert set(suites()) == methods | places | {"operators"}
    for name in suites():
        suite = load_suite(name)
        assert suite.name == name
        assert suite.names
        kinds = {**dict.fromkeys(methods, "methods"), **dict.fromkeys(places, "places")}
        assert suite.ranks == kinds.get(name, "operators")


def test_a_scenario_name_means_one_scenario() -> None:
    declared = [s for name in suites() for s in load_suite(name).scenarios]
    for scenario in declared:
        if not isinstance(scenario, TransferScenario):
            assert scenarios()[scenario.name] == scenario
    transfer = [s.name for s in declared if isinstance(s, TransferScenario)]
    assert len({*transfer}) == len(transfer)


RECORDED_TABLE = '[[scenarios]]\nkind = "recorded"\nname = "ohmc16"\nrecording = "ohmc16"\n'
NEW_SKINS = """\
name = "mine"
title = "My skins"
methods = ["kernel-ridge"]

[[scenarios]]
kind = "transfer"
recordings = ["cam09-05", "cam09-06", "ohmc16"]
labelled = [0, 25]
"""


def test_a_table_of_skins_and_counts_stands_for_each_pair(tmp_path: Path) -> None:
    path = tmp_path / "skins.toml"
    path.write_text(NEW_SKINS)
    suite = read_suite(path)
    assert [scenario.name for scenario in suite.scenarios] == [
        f"{skin}-{count}" for skin in ("cam09-05", "cam09-06", "ohmc16") for count in (0, 25)
    ]
    second = suite.scenarios[3]
    assert isinstance(second, TransferScenario)
    assert (second.recording, second.labelled) == ("cam09-06", 25)
    assert second.others == ("cam09-05", "ohmc16")
    assert Suite.model_validate_json(suite.model_dump_json()) == suite  # as in a manifest
    path.write_text(NEW_SKINS + 'others = ["cam09-07"]\n')
    assert {s.others for s in read_suite(path).scenarios} == {("cam09-07",)}  # type: ignore[union-attr]


def test_files_of_any_name_give_names_of_scenarios() -> None:
    files = ["日本.h5", "sub/left.h5", "left.h5", "Übung 2.h5", "LEFT.H5", "ohmc16"]
    assert _short_names(files) == ["recording-0", "left", "left-2", "ubung-2", "left-4", "ohmc16"]


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("recordings = [", "recordings = 3 #", r"recordings': a list is needed, such as \["),
        ("recordings = [", "recordings = [] #", r"recordings': a list is needed, such as \["),
        ("[0, 25]", "25", r"labelled': a list is needed, such as \[0, 25\]"),
        ('"ohmc16"]', '"superposed-pairs-cam09-05"]', "'cam09-05' and 'superposed.*the same file"),
        ("[0, 25]", "[-1]", "greater than or equal to 0"),
        ("[0, 25]", '["many"]', "valid integer"),
        ('"ohmc16"]', '"ktc2023"]', "'ktc2023' does not know where it was pressed"),
        ('"ohmc16"]', '"ohmc61"]', "'ohmc16'"),
        ("labelled = [0, 25]\n", 'labelled = [0]\nothers = ["ohmc16"]\n', "cannot be one of"),
        ('["kernel-ridge"]\n', f'["kernel-ridge"]\n{RECORDED_TABLE}', "a suite of their own"),
        ("methods", "operators", "operators need a known conductivity"),
    ],
)
def test_a_table_of_skins_that_is_wrong_is_named(
    tmp_path: Path, old: str, new: str, says: str
) -> None:
    path = tmp_path / "bad.toml"
    path.write_text(NEW_SKINS.replace(old, new))
    with pytest.raises(InputError, match=says):
        read_suite(path)


def test_paper_is_as_published() -> None:
    (paper,) = simulated("paper")
    assert (paper.train, paper.test, paper.families) == (24_000, 6_000, PUBLISHED_FAMILIES)
    assert paper.validation >= 1_000
    assert paper.noise == SplitNoise(train="mixture", validation="mixture", test="clean")
    assert paper.inverse_crime is True


def test_quick_has_simulated_and_recorded_data_without_inverse_crime() -> None:
    first, second = load_suite("quick").scenarios
    assert isinstance(first, SimulatedScenario)
    assert first.inverse_crime is False
    assert (first.noise.test, first.test) == (50.0, 36)
    assert isinstance(second, RecordedScenario)
    assert second.recording == "ohmc16"


@pytest.mark.parametrize(("suite", "crime"), [("noise", False), ("paper-noise", True)])
def test_noise_suites_share_phantoms_over_their_levels(suite: str, crime: bool) -> None:
    levels = simulated(suite)
    tests = [s.noise.test for s in levels]
    assert tests == (["clean"] if suite == "noise" else []) + [60.0, 50.0, 40.0, 30.0]
    assert [s.noise.validation for s in levels] == tests
    assert len({s.phantom_stream for s in levels}) == 1
    assert {s.inverse_crime for s in levels} == {crime}
    assert len({str(s.clean_parameters("test")) for s in levels}) == 1


@pytest.mark.slow
def test_objects_are_the_published_ones_on_an_imperfect_sensor() -> None:
    (objects,) = simulated("objects")
    assert objects.families == OBJECT_FAMILIES
    assert objects.training_families == PUBLISHED_FAMILIES
    assert objects.ladder
    assert objects.inverse_crime is False
    data = load(objects, "test", 6)
    for name, size, mm in (
        ("object-disc", "radius_m", 20), ("object-small-disc", "radius_m", 10),
        ("object-triangle", "leg_m", 40), ("object-l-shape", "arm_m", 50),
        ("object-l-shape", "width_m", 20), ("object-ring", "outer_m", 30),
    ):  # fmt: skip
        (drawn_m,) = data.samples.loc[data.samples["family"] == name, size].tolist()
        assert 1e3 * drawn_m == pytest.approx(mm, rel=0.0101)


def test_shapes_are_families_never_trained_on() -> None:
    (shapes,) = simulated("shapes")
    tested = {f.name for f in shapes.split_families("test")}
    others = {*PUBLISHED_FAMILIES, *OBJECT_FAMILIES, *TANK_FAMILIES}
    assert tested == set(FAMILIES) - others
    for split in ("train", "validation"):
        assert not tested & {f.name for f in shapes.split_families(split)}
    assert shapes.inverse_crime is False


def test_recorded_suite_lists_recorded_sets() -> None:
    assert {s.name for s in load_suite("recorded").scenarios} >= {
        "ohmc16", "ktc2023", "sciospec-tank",
    }  # fmt: skip


def test_own_suite_by_path(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(GOOD)
    suite = load_suite(str(path))
    assert [s.name for s in suite.scenarios] == ["first", "second"]
    assert (suite.limit, suite.fit_limit_s, suite.frame_limit_s) == (None, 600.0, 10.0)
    second = suite.scenarios[1]
    assert isinstance(second, SimulatedScenario)
    assert second.noise.test == 50.0


@pytest.mark.parametrize(
    ("old", "new", "field", "says"),
    [
        ('title = "My suite"', 'titel = "My suite"', "titel", "'title'"),
        ('name = "mine"', 'name = "My Suite"', "name", "small letters"),
        ('methods = ["noser"]', 'methods = "noser"', "methods", "it is a list"),
        ("", 'fit_limit_s = "3"\n', "fit_limit_s", "valid number"),
        ("", "limit = true\n", "limit", "valid integer"),
        ('title = "My suite"', "title = 2020-01-01", "title", "valid string"),
        ("", "frame_limit_s = inf\n", "frame_limit_s", "finite"),
        ("train = 0", 'train = "0"', "scenarios[0].train", "valid integer"),
        ("test = 6", "test = 0", "scenarios[0].test", "at least 1 test sample"),
        ("test = 6", "test = 6\nimage_shape = [40, 6]", "scenarios[0].image_shape", "7 x 7"),
        ('methods = ["noser"]', "methods = []", "methods", "it is empty"),
        ("", "limit = 0\n", "limit", "greater than or equal to 1"),
        ("", "first = { noser = 0 }\n", "first.noser", "greater than or equal to 1"),
        ("", "first = { nosr = 6 }\n", "first", "none of the `methods`"),
        ("", "frame_limit_s = -1\n", "frame_limit_s", "greater than 0"),
        ('name = "second"', 'name = "first"', "scenarios", "declared twice"),
        (
            'name = "second"',
            SECOND + '"frist"',
            "scenarios",
            "'frist', and the suite declares first, second",
        ),
        ('name = "second"', SECOND + '"second"', "scenarios", "is the scenario itself"),
        (
            'name = "second"',
            SECOND + '"first"\nimage_shape = [9, 9]',
            "scenarios",
            "whose sensor, image or range",
        ),
        ('["circle", "ring"]', '["circle", "rign"]', "scenarios[1].families", "'ring'"),
        ('["circle", "ring"]', "[]", "scenarios[1].families", "it is empty"),
        ('["circle", "ring"]', "[3]", "scenarios[1].families[0]", "valid string"),
        ('"ring"]', SLIT.replace("height", "hight"), SIZES, "'rectangle' are width, height"),
        ('"ring"]', SLIT.replace("0.5]", "1.5]"), SIZES, "a fraction of the sensor's side"),
        ('"ring"]', SLIT.replace("[0.4", "[0.6"), f"{SIZES}.width", "the smaller first"),
        ('"ring"]', SLIT.replace("rectangle", "rectangel"), SHAPE, "did you mean 'rectangle'?"),
        ('"ring"]', SLIT.replace("slit", "star"), "scenarios[1].families[1].name", "already"),
        ("noise = { test = 50 }", "noise = { test = -3 }", "scenarios[1].noise.test", "dB"),
        ("noise = { test = 50 }", 'noise = { test = "x" }', "scenarios[1].noise.test", "dB"),
        ("noise = { test = 50 }", "noise = { tset = 5 }", "scenarios[1].noise.tset", "'test'"),
        ("noise = { test = 50 }", "test_ = 5", "scenarios[1].test_", "unknown field"),
        ("name = ", "image_shape = [8, 8]\nname = ", "image_shape", "in another table"),
        ("noise = { test = 50 }", 'sensor = "foam17"', "scenarios[1].sensor", "'foam16'"),
        (
            "noise = { test = 50 }",
            'imperfections = { mesh = "x" }',
            "scenarios[1].imperfections.mesh",
            "'fine'",
        ),
        (
            "noise = { test = 50 }",
            "imperfections = { gain = inf }",
            "scenarios[1].imperfections.gain",
            "10",
        ),
        (
            "noise = { test = 50 }",
            "imperfections = { drift = 1e6 }",
            "scenarios[1].imperfections.drift",
            "10",
        ),
        (
            "noise = { test = 50 }",
            "imperfections = { dead = [16] }",
            "scenarios[1]",
            "`dead` names one",
        ),
        (
            "noise = { test = 50 }",
            f"imperfections = {{ dead = {list(range(15))} }}",
            "scenarios[1]",
            "no measurement",
        ),
        (
            "noise = { test = 50 }",
            'sensor = "ohmc16"\nimperfections = { mesh = "slab" }',
            "scenarios[1]",
            "for rectangles",
        ),
        ("noise = { test = 50 }", "image_shape = [1, 9]", "scenarios[1].image_shape[0]", "2"),
        ("train = 0", "train = -1", "scenarios[0].train", "greater"),
        ("train = 0", "train = 1.5", "scenarios[0].train", "integer"),
        ("train = 0", "", "scenarios[0].train", "missing"),
        ('kind = "simulated"', 'kind = "real"', "scenarios[0].kind", "'recorded'"),
        ('kind = "simulated"', "", "scenarios[0].kind", "'recorded'"),
        ("methods =", 'operators = ["fem"]\nmethods =', "operators", "either `methods` or"),
        ('methods = ["noser"]', "", "operators", "either `methods` or `operators`"),
        ('methods = ["noser"]', "operators = []", "operators", "it is empty"),
    ],
)
def test_a_bad_suite_file_is_named_with_the_field(
    tmp_path: Path, old: str, new: str, field: str, says: str
) -> None:
    path = tmp_path / "bad.toml"
    path.write_text(GOOD.replace(old, new, 1) if old else new + GOOD)
    with pytest.raises(InputError) as caught:
        read_suite(path)
    message = str(caught.value)
    assert message.startswith(f"Suite file {path}, field '{field}'")
    assert ("of 'first'" in message) == field.startswith("scenarios[0].")
    assert says in message
    assert "\n" not in message
    assert "?." not in message


def test_a_scenario_declares_families_of_its_own_which_its_data_hash_holds(
    tmp_path: Path,
) -> None:
    path = tmp_path / "own.toml"
    hashes = set()
    for slit in (SLIT, SLIT.replace("0.4", "0.45"), SLIT.replace("0.2", "0.3")):
        path.write_text(GOOD.replace('"ring"]', slit, 1))
        scenario = read_suite(path).scenarios[1]
        assert isinstance(scenario, SimulatedScenario)
        hashes |= {scenario.data_hash("test"), content_hash(scenario.clean_parameters("test"))}
        again = Suite.model_validate_json(read_suite(path).model_dump_json())  # as in a manifest
        assert again.scenarios[1].data_hash("test") == scenario.data_hash("test")
    assert len(hashes) == 6
    assert isinstance(scenario, SimulatedScenario)
    drawn = phantom(scenario, "test", 1)
    assert (drawn.family, len(drawn.inclusions)) == ("slit", 2)
    assert 0.04 <= drawn.parameters["width_1_m"] <= 0.05
    assert 0.3 <= drawn.parameters["conductivity_2"] <= 0.5


@pytest.mark.parametrize(("new", "line"), [("train = ", 9), ("train = 0\ntrain = 1", 10)])
def test_a_file_that_is_no_toml_is_named_with_the_line(tmp_path: Path, new: str, line: int) -> None:
    path = tmp_path / "bad.toml"
    path.write_text(GOOD.replace("train = 0", new, 1))
    with pytest.raises(InputError, match=f"{path.name} is not valid TOML.*line {line}"):
        read_suite(path)


OPERATORS = GOOD.replace("methods = [", "operators = [")


@pytest.mark.parametrize(
    ("text", "field", "says"),
    [
        (OPERATORS.replace("validation = 6", "validation = 1", 1), "validation", "at least 2"),
        (OPERATORS.replace("test = 6", "test = 0", 1), "test", "at least 1 test sample"),
        (RECORDED.replace("methods", "operators"), "kind", "only simulated"),
        (RECORDED.replace("ohmc16", "omhc16"), "recording", "'ohmc16'"),
    ],
)
def test_a_scenario_that_cannot_be_run_is_named(
    tmp_path: Path, text: str, field: str, says: str
) -> None:
    path = tmp_path / "bad.toml"
    path.write_text(text)
    with pytest.raises(InputError, match=rf"field 'scenarios\[0\].{field}' of .*{says}"):
        read_suite(path)


@pytest.mark.parametrize(
    ("text", "ranks", "side"), [(GOOD, "methods", 7), (OPERATORS, "operators", 5)]
)
def test_the_smallest_grid_of_methods_is_what_ssim_needs(
    tmp_path: Path, text: str, ranks: str, side: int
) -> None:
    assert WINDOW == image_metrics.WINDOW
    path = tmp_path / "small.toml"
    path.write_text(text.replace("test = 6", f"test = 6\nimage_shape = [{side}, {side}]", 1))
    suite = read_suite(path)
    assert suite.scenarios[0].nominal_sensor.image_shape == (side, side)
    assert (suite.ranks, suite.names) == (ranks, ("noser",))


def test_operators_are_ranked_on_the_paper_and_on_a_finer_mesh() -> None:
    paper, finer = simulated("operators")
    assert paper == simulated("paper")[0]
    assert finer == paper.model_copy(
        update={
            "name": "paper-finer",
            "imperfections": Imperfections(mesh="fine"),
            "phantoms": "paper",
        }
    )
    assert finer.phantom_stream == paper.phantom_stream
    assert (paper.inverse_crime, finer.inverse_crime) == (True, False)


def test_unreadable_suite_files_are_one_sentence(tmp_path: Path) -> None:
    binary = tmp_path / "binary.toml"
    binary.write_bytes(b"\xff\xfe\x00")
    for path, says in [(binary, "not UTF-8 text"), (tmp_path / "none.toml", "No such file")]:
        with pytest.raises(InputError, match=f"uite file {path}.*{says}"):
            load_suite(path)
    with pytest.raises(InputError, match=r"ends in \.toml"):
        load_suite(str(tmp_path / "suite.yaml"))
    with pytest.raises(InputError, match=r"is a folder: give the name of a suite, or a file"):
        load_suite(str(tmp_path))


def test_unknown_names_suggest_the_nearest() -> None:
    with pytest.raises(InputError, match="Unknown suite 'papr': did you mean 'paper'"):
        load_suite("papr")
    with pytest.raises(InputError, match=r"Unknown suite 'nosuch': known: .*quick"):
        load_suite("nosuch")
    with pytest.raises(InputError, match="Unknown scenario 'noise-50': did you mean 'noise-50db'"):
        scenario_by_name("noise-50")


def test_a_suite_moves_to_another_sensor_and_says_why_it_cannot() -> None:
    moved = on_sensor(load_suite("acuity"), "ohmc16")
    assert len(moved.scenarios) == 3
    for scenario in moved.scenarios:
        assert isinstance(scenario, SimulatedScenario)
        assert scenario.nominal_sensor.name == "ohmc16"
    with pytest.raises(InputError, match="has no simulated scenario"):
        on_sensor(load_suite("two-touch"), "ohmc16")
    with pytest.raises(InputError, match="foam15"):
        on_sensor(load_suite("acuity"), "foam15")


def test_what_is_told_from_a_recording_is_not_run_without_it(tmp_path: Path) -> None:
    file = tmp_path / "r.toml"
    told = '[[scenarios]]\nkind = "simulated"\nname = "s"\nsensor = "ohmc16"\nfamiliar = "r"\n'
    file.write_text(
        RECORDED + told + 'families = ["soft-press"]\ntrain = 2\nvalidation = 2\ntest = 2\n'
    )
    suite, said = load_suite(file), "the familiar scenario of 's' is 'r', and the suite"
    with pytest.raises(InputError, match=said):
        on_sensor(suite, "foam16")
    with pytest.raises(InputError, match=said):
        drawn_with(suite, bytes(32))
