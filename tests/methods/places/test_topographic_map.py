"""The map from places to frames: of known smooth surfaces, and of a real skin."""

import numpy as np
import pytest
from numpy.typing import NDArray

from eitbench.methods.place_method import PlaceProblem
from eitbench.methods.places.by_image import create_place_method
from eitbench.methods.places.regressions import learned_from
from eitbench.methods.places.topographic_map import compressed, disc_of, spread
from eitbench.methods.problem import no_split
from eitbench.scenarios import sensor
from eitbench.scenarios.data.transfer import Learnable, Presses, load_transfer
from eitbench.scenarios.errors import InputError
from eitbench.scenarios.similarity import fit_similarity
from eitbench.scenarios.suites.scenario import TransferScenario

Array = NDArray[np.float64]
SENSOR = sensor("ohmc16")
RADIUS = 0.05


def evenly(n: int, seed: int) -> Array:
    """Places (n, 2) [m] over a disc."""
    draws = np.random.default_rng(seed)
    radius, angle = RADIUS * np.sqrt(draws.uniform(size=n)), draws.uniform(0, 2 * np.pi, n)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)


def skin(seed: int, unlike: float) -> dict[str, Array]:
    """A skin's points and gains; `unlike` says how far they are from those that all skins share."""
    shared, own = np.random.default_rng(0), np.random.default_rng(seed)
    m = SENSOR.n_measurements
    return {
        "points": shared.uniform(-0.08, 0.08, (m, 2)) + unlike * 0.04 * own.standard_normal((m, 2)),
        "gains": shared.choice([-1, 1], m) * np.exp(unlike * own.standard_normal(m)),
        # Boards disturb many values alike: the noise of a value is not its own alone.
        "disturbances": 0.05 * own.standard_normal((3, m)),
    }


def frames(places: Array, of: dict[str, Array], seed: int) -> Array:
    """Frames (n, M) that fall off with the distance from the skin's points, with noise."""
    draws = np.random.default_rng(seed)
    distance = np.linalg.norm(places[:, None] - of["points"], axis=2)
    clean = of["gains"] * np.exp(-((distance / 0.03) ** 2))
    clean += draws.standard_normal((len(places), 3)) @ of["disturbances"]
    return np.asarray(draws.uniform(0.5, 2, (len(places), 1)) * clean)


def problem(
    labelled: int, others: int = 0, n: int = 500, origin: Array | float = 0.0
) -> tuple[PlaceProblem, Array, Array]:
    """A skin with unlabelled presses, and differences and places of 200 further ones.

    The robot gives the centre of the skin the coordinates `origin` [m].
    """
    of, places, tested = skin(9, 0.5), evenly(n, 1), evenly(200, 2)
    differences = frames(places, of, 3)
    given = Learnable(
        SENSOR,
        np.ones(SENSOR.n_measurements),
        Presses(differences[:labelled], places[:labelled] + origin),
        differences,
        {
            str(k): Presses(frames(evenly(80, k), skin(k, 0.5), k), evenly(80, k))
            for k in range(20, 20 + others)
        },
    )
    return PlaceProblem(given, no_split), frames(tested, of, 4), tested


def error(found: Array, true: Array) -> float:
    """Median distance [mm]."""
    return float(1e3 * np.median(np.hypot(*(found - true).T)))


def located(name: str, given: PlaceProblem, tested: Array) -> Array:
    """Places (n, 2) [m] that a method finds."""
    method = create_place_method(name)
    method.fit(given)
    return method.locate(tested)


def test_unlabelled_presses_lower_the_error_of_ten_labelled_ones() -> None:
    given, tested, true = problem(labelled=10)
    alone = error(located("kernel-ridge", given, tested), true)
    mapped = error(located("topographic-map", given, tested), true)
    assert mapped < 0.7 * alone


def test_a_skin_without_labelled_presses_is_mapped_from_other_skins() -> None:
    given, tested, true = problem(labelled=0, others=4)
    errors = {}
    for name in ("kernel-ridge-skins", "topographic-map-skins"):
        found = located(name, given, tested)
        register = fit_similarity(found[:25], true[:25])
        assert register is not None
        errors[name] = error(register(found[25:]), true[25:])
    assert errors["topographic-map-skins"] < 0.6 * errors["kernel-ridge-skins"]


def test_other_skins_help_wherever_the_robot_counts_from() -> None:
    """Places of other skins are the sensor's, labelled ones those of this skin's robot."""
    given, tested, true = problem(labelled=25, others=4)
    moved = np.array([0.3, -0.2])
    elsewhere, _, _ = problem(labelled=25, others=4, origin=moved)
    centred = located("topographic-map-skins", given, tested)
    found = located("topographic-map-skins", elsewhere, tested)
    assert error(centred, true) < 4
    assert error(found - moved, true) < 1.2 * error(centred, true)


@pytest.mark.nightly
@pytest.mark.usefixtures("recorded_data")
def test_unlabelled_presses_of_a_real_skin_halve_the_error() -> None:
    data = load_transfer(TransferScenario(name="new", recording="cam09-16", labelled=25))
    tested = data.test.voltages - data.test.references
    true = data.test.samples[["x_m", "y_m"]].to_numpy()
    errors = [
        error(located(name, PlaceProblem(data.given, no_split), tested), true)
        for name in ("kernel-ridge", "topographic-map")
    ]
    assert errors[1] < 0.5 * errors[0]


def test_without_anything_to_guess_from_all_presses_are_in_one_place() -> None:
    for name in ("topographic-map", "topographic-map-skins"):
        given, tested, _ = problem(labelled=0)
        assert (located(name, given, tested) == [0, 0]).all()


def test_places_depend_neither_on_the_units_nor_on_the_strength_of_a_press() -> None:
    given, tested, _ = problem(labelled=25, n=100)
    method = create_place_method("topographic-map")
    method.fit(given)
    strength = np.linspace(1, 1000, len(tested))[:, None]
    assert np.allclose(method.locate(tested * strength), method.locate(tested), atol=1e-9)


def test_a_frame_is_compressed_to_signed_square_roots_of_unit_rms() -> None:
    assert np.allclose(compressed(np.array([[4.0, -9.0, 0.0, 1.0]])) ** 2 / 4 * 14, [[4, 9, 0, 1]])
    assert (np.sign(compressed(np.array([[4.0, -9.0]]))) == [1, -1]).all()


@pytest.mark.parametrize("n", [10, 25, 400])
def test_the_disc_that_presses_are_drawn_from_is_found(n: int) -> None:
    found = [disc_of(evenly(n, seed) + np.array([0.1, -0.2])) for seed in range(20)]
    radii = np.array([disc.radius for disc in found])
    centres = np.array([disc.centre for disc in found]) - [0.1, -0.2]
    assert abs(radii.mean() / RADIUS - 1) < 0.05
    assert np.hypot(*centres.T).max() < RADIUS * 1.5 / np.sqrt(n)


def test_presses_along_a_row_have_a_disc_and_no_skins_are_told() -> None:
    disc = disc_of(np.column_stack([np.linspace(0, 0.08, 9), np.full(9, 0.01)]))
    assert disc.centre == pytest.approx((0.04, 0.01), abs=1e-4)
    assert disc.radius == pytest.approx(0.04 * (1 + 1 / 9), rel=0.01)
    with pytest.raises(InputError, match="no other skins to learn from"):
        learned_from({}, 10)


def test_guesses_near_the_middle_are_spread_evenly_and_keep_their_directions() -> None:
    places = 0.1 * evenly(400, 5) / RADIUS + [0.3, 0.1]
    found = spread(places, places)
    radii = np.hypot(*found.T)
    assert radii.max() <= 1
    assert abs(np.mean(radii**2) - 0.5) < 0.02  # of an even disc
    centre = np.median(places, axis=0)
    assert np.allclose(
        found / radii[:, None], (places - centre) / np.hypot(*(places - centre).T)[:, None]
    )
