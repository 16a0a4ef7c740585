"""Units of a sensor that training data are of, good ones and bad ones.

What learns from the nominal sensor alone relies on a model that no real sensor follows. Where units
are drawn at random around it, the real one is a unit among others.

Source: Tobin et al., IROS 2017, 23 (domain randomisation).
"""

from typing import Annotated, Self

from pydantic import Field, model_validator

from eitbench.scenarios.imperfections.imperfections import (
    FIRST_TRAINING_UNIT,
    Imperfections,
    channels,
)
from eitbench.scenarios.seeds import generator
from eitbench.scenarios.sensors.patterns import DrivePattern

Share = Annotated[float, Field(ge=0, le=1)]


class TrainingImperfections(Imperfections):
    """Imperfections of the units of training data, each with a severity and faults of its own.

    The severity of a unit is uniform from 0 to twice the declared one.

    Attributes:
        dead_share: share of units that have one electrode without contact or, half as often, two.
        saturated_share: share of units that have a channel which clips.
    """

    dead_share: Share = 0.0
    saturated_share: Share = 0.0

    @model_validator(mode="after")
    def _drawn_or_declared(self) -> Self:
        if (self.dead and self.dead_share) or (self.saturated is not None and self.saturated_share):
            raise ValueError(
                "faults are either the same in all units (`dead`, `saturated`) or drawn for each "
                "(`dead_share`, `saturated_share`)"
            )
        return self

    def of_session(self, session: int, pattern: DrivePattern) -> Imperfections:
        """Imperfections of the unit of a session, on a sensor with the drive pattern `pattern`."""
        unit = FIRST_TRAINING_UNIT + self.unit + session
        rng = generator("training unit", unit)
        own: dict[str, object] = {"unit": unit, "severity": rng.uniform(0, 2 * self.severity)}
        if rng.random() < self.dead_share:
            electrodes = rng.permutation(int(pattern.table.max()) + 1)
            own["dead"] = tuple(electrodes[: 1 + (rng.random() < 1 / 3)].tolist())
        if rng.random() < self.saturated_share:
            own["saturated"] = int(rng.integers(len(channels(pattern)[1])))
        declared = {name: getattr(self, name) for name in Imperfections.model_fields}
        # Twice the greatest severity that can be declared may be drawn.
        return Imperfections.model_construct(**declared | own)
