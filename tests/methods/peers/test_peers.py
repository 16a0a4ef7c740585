"""Other people's software, given our sensors: order, signs, places and scale arrive as they are."""

import gc
import importlib.util
import os
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from tests.support.small_sensors import clean_problem

from eitbench.commands.listing import LISTINGS
from eitbench.methods import Problem, create, methods
from eitbench.methods.peers.eidors import FOLDER, Octave, missing
from eitbench.methods.peers.peer import calibration_discs, interpolation
from eitbench.methods.peers.pyeit_methods import pyeit_mesh, pyeit_protocol, signed_distance
from eitbench.reports.tables.leaderboard import FORMATS, ranked_rows
from eitbench.scenarios.catalogue import sensor
from eitbench.scenarios.errors import EitbenchError, InputError
from eitbench.scenarios.physics.forward import forward_model
from eitbench.scenarios.sensors.patterns import DrivePattern, offset_pattern, pair_pattern
from eitbench.scenarios.sensors.sensor import Sensor

Array = NDArray[np.float64]

STUB = Path(__file__).parent / "data" / "octave_stub.py"
PYEIT = ["pyeit-jac", "pyeit-greit", "pyeit-bp"]
EIDORS = ["eidors-noser", "eidors-greit", "eidors-tv-pdipm"]
needs_pyeit = pytest.mark.skipif(
    importlib.util.find_spec("pyeit") is None, reason="pyEIT is not installed (extra `peers`)"
)


def coarse(name: str) -> Sensor:
    """A sensor on a coarser grid, on which pixels still end where electrodes do."""
    found = sensor(name)
    height, width = found.image_shape
    return replace(found, image_shape=(height // 2, width // 2))


def disc(of: Sensor, x: Array, y: Array) -> NDArray[np.bool_]:
    """Mask of the points in a disc that no turn or mirror image of the sensor leaves in place."""
    x0, y0, x1, y1 = of.outline.bounds
    apart = np.hypot(x - (x0 + 0.82 * (x1 - x0)), y - (y0 + 0.64 * (y1 - y0)))
    return np.asarray(apart < 0.12 * max(x1 - x0, y1 - y0))


def from_unit(of: Sensor, points: Array) -> Array:
    """Points (p, 2) [m] from pyEIT's, in which the longer half side is 1."""
    x0, y0, x1, y1 = of.outline.bounds
    return points * max(x1 - x0, y1 - y0) / 2 + np.array([x0 + x1, y0 + y1]) / 2


def touched(of: Sensor, factor: float = 0.5) -> tuple[Problem, Array, Array]:
    """The problem, one frame (1, M) of a board with a gain, and the conductivity (H, W)."""
    model = forward_model(of)
    sigma = of.background * np.where(disc(of, *of.pixel_centres), factor, 1.0)
    gain = 250.0
    return clean_problem(of, gain), gain * model.voltages(sigma)[None], sigma


def assert_in_place(
    image: Array, problem: Problem, sigma: Array, least: float = 0.5, gap: float = 0.2
) -> None:
    """The image is correlated with the truth, and more than it would be turned or mirrored."""
    mask = problem.mask
    contrast = np.where(mask, image - problem.background, 0.0)
    truth = np.where(mask, sigma - problem.background, 0.0)
    turns = [contrast, contrast[::-1], contrast[:, ::-1], contrast[::-1, ::-1]]
    if truth.shape[0] == truth.shape[1]:
        turns += [turned.T for turned in turns]
    alike = [float(np.corrcoef(t[mask], truth[mask])[0, 1]) for t in turns]
    assert alike[0] > least
    assert alike[0] > max(alike[1:]) + gap


# ---- scale -------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "alike"), [("foam16", [4, 4, 4, 8, 8, 8]), ("ohmc16", [1] * 32), ("ktc2023", [1] * 32)]
)
def test_discs_that_symmetries_move_onto_one_another_are_solved_once(
    name: str, alike: list[int]
) -> None:
    discs, counts = calibration_discs(clean_problem(coarse(name)))
    assert sorted(counts) == alike
    assert len({disc.tobytes() for disc in discs}) == len(alike)


# ---- pyEIT -------------------------------------------------------------------------------------


@needs_pyeit
@pytest.mark.parametrize(
    "pattern",
    [
        offset_pattern(16, 3),
        offset_pattern(8, 4, driven=True),
        DrivePattern(np.array([[0, 1, 2, 3], [0, 1, 3, 4], [4, 2, 1, 0], [0, 1, 2, 3]])),
        pair_pattern([(0, 1), (1, 2)], [(2, 3), (3, 4), (4, 5)]),
    ],
)
def test_the_protocol_holds_the_pattern_row_by_row(pattern: DrivePattern) -> None:
    plan = pyeit_protocol(pattern)
    drives = np.repeat(plan.ex_mat, plan.n_meas, axis=0)
    np.testing.assert_array_equal(np.hstack([drives, plan.meas_mat.reshape(-1, 2)]), pattern.table)
    if len(pattern.table) == 208:  # its runs are equal: one is a whole excitation
        assert plan.meas_mat.shape == (16, 13, 2)


@pytest.mark.slow
@needs_pyeit
@pytest.mark.parametrize(
    "name", ["foam16", "ohmc16", "hydrogel-rectangle", "jku-tank-opposite", "ktc2023"]
)
def test_meshes_fill_the_outline_and_put_electrodes_in_their_places(name: str) -> None:
    of = sensor(name)
    mesh = pyeit_mesh(of)
    nodes = from_unit(of, mesh.node[:, :2])
    centres = of.outline.point(np.array([e.centre for e in of.electrodes]))
    np.testing.assert_allclose(nodes[mesh.el_pos], centres, atol=1e-9)
    a, b, c = np.moveaxis(nodes[mesh.element], 1, 0)
    areas = ((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]) / 2
    rim = of.outline.point(np.linspace(0, of.outline.perimeter, 4001)[:-1])
    x, y = rim.T
    area = np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y) / 2
    assert areas.min() > 0
    assert areas.sum() == pytest.approx(area, rel=0.01)
    assert set(mesh.element.ravel()) == set(range(mesh.n_nodes))


@pytest.mark.slow
@needs_pyeit
@pytest.mark.parametrize("name", ["foam16", "ohmc16", "hydrogel-rectangle", "sciospec-tank"])
def test_pyeit_measures_what_our_model_measures(name: str) -> None:
    """In our order, with our signs, on a touched sensor; point electrodes cost a few per cent."""
    from pyeit.eit.fem import EITForward

    of = sensor(name)
    of = replace(of, pattern=DrivePattern(of.pattern.table))
    mesh = pyeit_mesh(of)
    forward = EITForward(mesh, pyeit_protocol(of.pattern))
    problem, frame, _ = touched(of)
    ours = frame[0] / 250 * of.background
    inside = disc(of, *from_unit(of, mesh.elem_centers[:, :2]).T)
    theirs = forward.solve_eit(np.where(inside, 0.5, 1.0))
    untouched = problem.background_voltages * of.background
    changed = np.corrcoef(ours - untouched, theirs - forward.solve_eit(1.0))[0, 1]
    assert np.corrcoef(ours, theirs)[0, 1] > 0.99
    assert changed > 0.97
    large = np.abs(ours) > 0.01 * np.abs(ours).max()
    assert (np.sign(ours) == np.sign(theirs))[large].all()


@pytest.mark.slow
@needs_pyeit
def test_meshes_do_not_depend_on_random_numbers() -> None:
    of = coarse("foam16")
    meshes = []
    for seed in (1, 2):
        np.random.seed(seed)  # noqa: NPY002  pyEIT draws from the global generator
        pyeit_mesh.cache_clear()
        meshes.append(pyeit_mesh(of))
    np.testing.assert_array_equal(meshes[0].node, meshes[1].node)
    np.testing.assert_array_equal(meshes[0].element, meshes[1].element)


@pytest.mark.slow
@needs_pyeit
def test_jac_is_what_pyeit_makes_of_its_own_protocol() -> None:
    """pyEIT's own adjacent protocol measures with the other sign, which no image may show."""
    from pyeit.eit import protocol
    from pyeit.eit.jac import JAC

    of = replace(coarse("foam16"), pattern=offset_pattern(16, 1))
    problem, frame, _ = touched(of, 0.9)
    method: Any = create("pyeit-jac")
    method.fit(problem)
    reference = method.unit_frames(problem.reference / problem.gain)
    found = method.contrast(problem.difference(frame), reference)[0]

    theirs = JAC(pyeit_mesh(of), protocol.create(16, dist_exc=1, step_meas=1, parser_meas="std"))
    theirs.setup(p=0.5, lamb=0.01, method="kotre", jac_normalized=True)
    elements = theirs.solve(-frame[0] / 250, -problem.reference / 250, normalize=True)
    pixels = np.column_stack([c[problem.mask] for c in of.pixel_centres])
    points = from_unit(of, pyeit_mesh(of).elem_centers[:, :2])
    expected = interpolation(points, pixels) @ elements
    np.testing.assert_allclose(found, expected, atol=1e-9 * np.abs(expected).max())


@pytest.mark.slow
@needs_pyeit
@pytest.mark.parametrize("name", PYEIT)
@pytest.mark.parametrize("of", ["foam16", "ohmc16", "hydrogel-rectangle16"])
def test_pyeit_s_images_stand_in_their_places(name: str, of: str) -> None:
    problem, frame, sigma = touched(coarse(of))
    method = create(name)
    method.fit(problem)
    image = method.reconstruct(frame)[0]
    assert image.shape == problem.mask.shape
    blurred = {"least": 0.2, "gap": 0.05} if name == "pyeit-bp" else {}
    assert_in_place(image, problem, sigma, **blurred)
    assert method.differs.startswith("run by pyEIT with point electrodes")
    assert f"{pyeit_mesh(problem.sensor).n_elems} triangles" in method.differs


@pytest.mark.slow
@needs_pyeit
def test_the_scale_does_not_depend_on_gain_or_background() -> None:
    of = coarse("foam16")
    problem, frame, _ = touched(of)
    method = create("pyeit-greit")
    method.fit(problem)
    image = method.reconstruct(frame)
    other_sensor = replace(
        of,
        background=0.2,
        electrodes=tuple(replace(e, contact_impedance=5e-3) for e in of.electrodes),
    )
    model = forward_model(other_sensor)
    again = create("pyeit-greit")
    again.fit(clean_problem(other_sensor, 0.01))
    sigma = 0.2 * np.where(disc(of, *of.pixel_centres), 0.5, 1.0)
    np.testing.assert_allclose(
        again.reconstruct(0.01 * model.voltages(sigma)[None]) / 0.2, image, atol=1e-6
    )
    # A disc like those of the calibration comes out near its 0.5; blur costs some of it.
    assert 0.4 < image[0][disc(of, *of.pixel_centres)].mean() < 0.85


@needs_pyeit
def test_distance_to_the_rim() -> None:
    points = np.array([[0.0, 0.0], [0.5, 0.0], [1.5, 0.0], [2.0, 2.0], [0.0, 1.0]])
    square = signed_distance(sensor("foam16").outline, points)
    np.testing.assert_allclose(square, [-1, -0.5, 0.5, np.sqrt(2), 0], atol=1e-12)
    disc = signed_distance(sensor("ohmc16").outline, points)
    np.testing.assert_allclose(disc, [-1, -0.5, 0.5, np.sqrt(8) - 1, 0], atol=1e-12)


def test_without_pyeit_a_method_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("eitbench.scenarios.extras.find_spec", lambda name: None)
    of = coarse("foam16")
    for name in PYEIT:
        why = methods()[name].unusable(of)
        assert why == "pyEIT is not installed: pip install 'eitbench[peers]'."
        with pytest.raises(InputError, match="\\[peers\\]"):
            create(name).fit(touched(of)[0])


def test_listings_say_what_differs() -> None:
    rows = {row["name"]: row for row in LISTINGS["methods"]()}
    assert rows["noser"]["differs"] == ""
    assert "point electrodes" in str(rows["pyeit-jac"]["differs"])
    assert "EIDORS" in str(rows["eidors-greit"]["differs"])


@pytest.mark.slow
@needs_pyeit
def test_a_run_keeps_and_shows_what_differs(
    eitbench: Callable[..., tuple[int, str, str]], tmp_path: Path
) -> None:
    suite = Path(__file__).parents[2] / "benchmark" / "data" / "tiny.toml"
    run = tmp_path / "run"
    code, out, err = eitbench("run", suite, "--methods", "pyeit-bp", "--limit", "1", "--out", run)
    assert code == 0, err
    words = "pyeit-bp: run by pyEIT with point electrodes on a mesh of its own (897 triangles)"
    assert words in " ".join(out.split())
    rows = ranked_rows([run])
    assert [f"pyeit-bp: {row['differs']}" for row in rows] == [words]
    for form, write in FORMATS.items():
        assert "point electrodes on a mesh of its own" in write(rows), form


# ---- EIDORS ------------------------------------------------------------------------------------


def compiled(folder: Path) -> Path:
    """Where EIDORS leaves what it compiles when it is started first."""
    return folder / "arch" / "octave" / "x86_64-pc-linux-gnu" / "eidors_var_id.mex"


@pytest.fixture
def stub(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """A program `octave` that solves requests itself; returns the file of what it was asked."""
    program = tmp_path / "bin" / "octave"
    program.parent.mkdir()
    program.write_text(f"#!{sys.executable}\n{STUB.read_text()}")
    program.chmod(0o755)
    (tmp_path / "startup.m").write_text("")
    compiled(tmp_path).parent.mkdir(parents=True)
    compiled(tmp_path).write_text("")
    monkeypatch.setenv("PATH", f"{program.parent}{os.pathsep}{os.environ['PATH']}")
    monkeypatch.setenv(FOLDER, str(tmp_path))
    monkeypatch.setenv("STUB_LOG", str(tmp_path / "asked.npz"))
    return tmp_path / "asked.npz"


@pytest.mark.slow
@pytest.mark.parametrize("of", ["foam16", "ohmc16"])
def test_a_reader_of_the_request_measures_what_our_model_measures(stub: Path, of: str) -> None:
    """Its own finite elements agree with ours, in our order and with our signs."""
    problem, _, _ = touched(coarse(of))
    create("eidors-noser").fit(problem)
    with np.load(stub, allow_pickle=False) as asked:
        theirs, reference = asked["voltages"], asked["reference"]
        assert asked["n"] == problem.sensor.n_measurements
        assert list(asked["options"]) == ["--no-gui", "--quiet", "--norc"]
    table = DrivePattern(problem.sensor.pattern.table)
    signed = forward_model(replace(problem.sensor, pattern=table))
    ours = signed.voltages(signed.background) * problem.background
    assert np.linalg.norm(theirs - ours) < 0.03 * np.linalg.norm(ours)
    np.testing.assert_allclose(reference, ours, rtol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("name", EIDORS)
def test_what_octave_answers_stands_in_its_place(stub: Path, name: str) -> None:
    problem, frame, sigma = touched(coarse("foam16"))
    method = create(name)
    method.fit(problem)
    images = method.reconstruct(np.concatenate([frame, problem.reference[None]]))
    # No frame has waited for a start.
    assert stub.with_name("starts.txt").read_text() == "started\n"
    assert_in_place(images[0], problem, sigma)
    np.testing.assert_allclose(images[1], problem.background, atol=1e-6)
    assert method.differs.startswith("run by EIDORS in Octave on a coarser mesh")
    with np.load(stub, allow_pickle=False) as asked:
        assert f"eidors-{asked['algorithm']}" == name


@pytest.mark.slow
@pytest.mark.parametrize(
    ("fault", "sentence"),
    [
        ("error", "Octave ended with code 1: error: 'prior_noser' undefined"),
        ("silent", "Octave ended with code 0: it gave no reason"),
        ("shape", r"EIDORS answered points \(5, 2\) and values \(4, 208\), not"),
        ("nan", "not finite ones of shapes"),
    ],
)
def test_a_failing_octave_is_one_sentence(
    stub: Path, monkeypatch: pytest.MonkeyPatch, fault: str, sentence: str
) -> None:
    monkeypatch.setenv("STUB_FAULT", fault)
    with pytest.raises(EitbenchError, match=sentence):
        create("eidors-noser").fit(touched(coarse("foam16"))[0])


def test_octave_has_a_time_limit(stub: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("STUB_FAULT", "slow")
    with pytest.raises(EitbenchError, match=r"EIDORS took more than 2 s"):
        Octave().ask({"frames": np.zeros((3, 1))}, limit_s=2)


@pytest.mark.slow
def test_octave_starts_again_only_after_a_failure_and_ends_with_its_owner(
    stub: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    starts, request = stub.with_name("starts.txt"), {"frames": np.zeros((3, 1))}
    monkeypatch.setenv("STUB_FAULT", "zero")
    octave: Any = Octave()
    octave.ask(request)
    octave.ask(request)
    assert starts.read_text() == "started\n"
    first = octave._process
    first.kill()
    with pytest.raises(EitbenchError, match="Octave ended with code"):
        octave.ask(request)
    octave.ask(request)
    assert starts.read_text() == "started\nstarted\n"
    second = octave._process
    assert second.poll() is None
    del octave
    gc.collect()
    assert second.poll() is not None


def test_what_is_missing_and_how_to_get_it(
    eitbench: Callable[..., tuple[int, str, str]],
    stub: Path,
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
) -> None:
    assert missing() == ""
    monkeypatch.setenv(FOLDER, str(tmp_path / "nowhere"))
    assert "that folder holds no startup.m: get EIDORS with `git clone" in missing()
    monkeypatch.delenv(FOLDER)
    assert f"the environment variable {FOLDER} names, and it is not set: get" in missing()

    # What it compiles is not there yet.
    monkeypatch.setenv(FOLDER, str(tmp_path))
    compiled(tmp_path).unlink()
    monkeypatch.setenv("PATH", str(tmp_path / "bin"))
    assert missing().endswith("there is no program `mkoctfile` on the path: install octave-dev.")
    mkoctfile = tmp_path / "bin" / "mkoctfile"
    mkoctfile.write_text("#!/bin/sh\n")
    mkoctfile.chmod(0o755)
    start = tmp_path / "startup.m"
    assert missing().endswith(f"""it never was: start it with octave --eval "run('{start}')".""")
    with monkeypatch.context() as patched:  # a mode would not keep root out
        patched.setattr("os.access", lambda path, mode: mode != os.W_OK)
        assert missing().endswith(f"cannot be written to: name a copy of yours in {FOLDER}.")

    monkeypatch.setenv("PATH", str(tmp_path))
    assert "no program `octave` on the path: install the packages octave and octave-" in missing()
    code, _, err = eitbench("check", "eidors-noser")
    assert code == 2
    assert "'eidors-noser' cannot be checked here: EIDORS is run in GNU Octave" in err


@pytest.mark.nightly
@pytest.mark.skipif(bool(missing()), reason=missing())
@pytest.mark.parametrize("name", EIDORS)
def test_eidors_itself(name: str) -> None:
    problem, frame, sigma = touched(sensor("foam16"))
    method = create(name)
    method.fit(problem)
    assert_in_place(method.reconstruct(frame)[0], problem, sigma)
