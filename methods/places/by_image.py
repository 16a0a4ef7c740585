"""Methods that make images, taken for methods of places."""

import numpy as np

from eitbench.methods.method import Method
from eitbench.methods.place_method import PlaceMethod, PlaceProblem
from eitbench.methods.registry import METHOD_REGISTRY, PLACE_REGISTRY
from eitbench.scenarios.arrays import Array
from eitbench.scenarios.phantoms.contacts import locate
from eitbench.scenarios.similarity import fit_similarity


class PlacesOfImages(PlaceMethod):
    """The place of the contact in a method's image, registered by the labelled presses, if any.

    A frame without a contact in its image is placed in the middle of the sensor.
    """

    def __init__(self, method: Method) -> None:
        self._method = method
        self.source, self.differs = method.source, method.differs  # type: ignore[misc]

    def fit(self, problem: PlaceProblem) -> None:
        """Fit the method to the nominal sensor, and the similarity to the labelled presses."""
        self._problem = problem
        self._method.fit(problem.physics)
        self.train_s, self.trained_on = self._method.train_s, self._method.trained_on
        self._register = None
        labelled = problem.labelled
        if len(labelled):
            self._register = fit_similarity(self._found(labelled.differences), labelled.places)

    def locate(self, differences: Array) -> Array:
        """Places (n, 2) [m], in the sensor's coordinates where too few presses are labelled."""
        found = self._found(differences)
        lost = np.isnan(found[:, 0])
        found[lost] = self._problem.physics.sensor.outline.centre
        return found if self._register is None else self._register(found)

    def _found(self, differences: Array) -> Array:
        """Places (n, 2) in the sensor's coordinates [m]; NaN without a contact."""
        physics = self._problem.physics
        images = self._method.reconstruct(physics.reference + differences)
        return locate(np.asarray(images, np.float64) - physics.background, physics.sensor)


def create_place_method(name: str, **parameters: object) -> PlaceMethod:
    """The method of places `name`, or that of images, taken for one.

    Raises:
        InputError: as for `Registry.create`.
    """
    if name in METHOD_REGISTRY.known() and name not in PLACE_REGISTRY.known():
        return PlacesOfImages(METHOD_REGISTRY.create(name, **parameters))
    return PLACE_REGISTRY.create(name, **parameters)
