"""Press on a soft conducting layer: from pressure to 2-D conductivity.

The layer is an open-cell foam soaked with a conducting liquid or gel, on a rigid base, as thick as
`FoamLayer.thickness`. Three textbook laws, in order:

1. Pressure p to strain e under the indenter, a foam that is elastic at first and stiffens as its
   cells close (Gibson & Ashby, Cellular Solids, 2nd ed. 1997, ch. 5, joined by one hyperbola):

       p = E e / (1 - e / e_d)      so that     e(p) = p / (E + p / e_d)

2. Strain beside the indenter, at distance d from its edge. The layer is a Vlasov-Leontiev
   foundation: stiffness k = E / h, and shear stiffness T = G h / 3 when the displacement falls
   linearly to zero at the base. Its free surface obeys T w'' = k w, so the edge decays as

       e(d) = e(p) exp(-d / l),     l = sqrt(T / k) = h sqrt(G / (3 E)) = h / sqrt(6)

   with G = E / 2, as foams hardly bulge sideways (Poisson's ratio near 0). This is exact beside a
   straight edge; round a corner or a small disc it is an approximation.

3. Strain to conductivity. Liquid is squeezed out of the closing cells; the volume of the solid
   does not change, so the porosity is f(e) = 1 - (1 - f_0) / (1 - e). Archie's law (1942) with
   Bruggeman's exponent m = 3/2 gives the bulk conductivity, and a 2-D conductivity is bulk
   conductivity times what is left of the thickness:

       sigma(e) / sigma(0) = (1 - e) (f(e) / f_0)^m

It falls strictly with pressure: 2 kPa leave 0.91 of the background, 60 kPa leave 0.28.

Backwards, the laws give the pressure on the base under every pixel. Its integral over the sensor is
the force on the indenter, whatever its shape: nothing else carries it.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import brentq
from scipy.special import spence

from eitbench.scenarios.arrays import Array
from eitbench.scenarios.errors import InputError


@dataclass(frozen=True)
class FoamLayer:
    """The layer's constants.

    Attributes:
        thickness: h [m].
        modulus: Young's modulus E of the soaked foam [Pa].
        densification: strain e_d at which the cells are closed.
        porosity: f_0 of the untouched foam.
        exponent: Archie's m.
    """

    thickness: float = 0.01
    modulus: float = 20e3
    densification: float = 0.9
    porosity: float = 0.97
    exponent: float = 1.5

    @property
    def falloff(self) -> float:
        """Length l [m] over which strain decays beside an indenter."""
        return self.thickness / float(np.sqrt(6))

    def strain(self, pressure: ArrayLike) -> Array:
        """Strain (...) under an indenter that presses with `pressure` (...) [Pa]."""
        p = np.asarray(pressure, dtype=np.float64)
        return p / (self.modulus + p / self.densification)

    def conductivity_ratio(self, strain: ArrayLike) -> Array:
        """2-D conductivity (...) at `strain` (...) as a fraction of the untouched layer's."""
        left = 1 - np.asarray(strain, dtype=np.float64)
        porosity = 1 - (1 - self.porosity) / left
        return np.asarray(left * (porosity / self.porosity) ** self.exponent)

    def pressed(self, pressure: ArrayLike, distance: ArrayLike) -> Array:
        """Conductivity ratio (...) at a `distance` [m] from an indenter under `pressure` [Pa]."""
        decay = np.exp(-np.asarray(distance, dtype=np.float64) / self.falloff)
        return self.conductivity_ratio(self.strain(pressure) * decay)

    def pressure(self, conductivity_ratio: ArrayLike) -> Array:
        """Pressure [Pa] on the base where the 2-D conductivity is this fraction of the untouched.

        It is that of the firmest press where conductivity is lower than under it. Ratios above 1
        count as a pull, so that most of the noise cancels in a sum (the law is curved: not all of
        it); more than doubled they count as doubled.
        """
        ratios, pressures = self._inverse
        return np.interp(np.asarray(conductivity_ratio, dtype=np.float64), ratios, pressures)

    def carried(self, pressure: ArrayLike, radius: float) -> Array:
        """Force (...) [N] on a round indenter of that `radius` [m] under `pressure` (...) [Pa].

        The integral of the pressure on the base, in closed form, of a layer that goes on for ever:
        with a = e(p) / e_d it is pi r^2 p + 2 pi E e_d l (l Li_2(a) - r log(1 - a)).
        """
        p = np.asarray(pressure, dtype=np.float64)
        closed = self.strain(p) / self.densification
        beside = self.falloff * spence(1 - closed) - radius * np.log1p(-closed)
        around = 2 * np.pi * self.modulus * self.densification * self.falloff * beside
        return np.asarray(np.pi * radius**2 * p + around)

    def pressure_of(self, force: float, radius: float) -> float:
        """Pressure [Pa] under a round indenter that carries `force` [N], see `carried`.

        Raises:
            InputError: the law does not hold so far.
        """
        most = float(self.carried(PRESSURE_PA[1], radius))
        if force > most:
            raise InputError(
                f"The law of the foam holds up to {PRESSURE_PA[1]:g} Pa, which is {most:.1f} N "
                f"under an indenter of {1e3 * radius:g} mm radius, got {force:g} N."
            )
        ends = 0.0, PRESSURE_PA[1]
        return float(brentq(lambda p: float(self.carried(p, radius)) - force, *ends))

    @cached_property
    def _inverse(self) -> tuple[Array, Array]:
        """Ratios, increasing, and the pressures [Pa] that belong to them."""
        strain = np.linspace(float(self.strain(PRESSURE_PA[1])), -1.0, 4001)
        pressure = self.modulus * strain / (1 - strain / self.densification)
        return self.conductivity_ratio(strain), np.asarray(pressure)


PRESSURE_PA = (2e3, 60e3)
"""A light and a firm press: the range of the family `soft-press`."""

FOAM = FoamLayer()
