"""Reconstruction by a Fourier neural operator."""

from dataclasses import dataclass
from typing import ClassVar

from eitbench.methods.learned.image_networks import ImageNetworkMethod
from eitbench.methods.registry import register
from eitbench.methods.training import Recipe
from eitbench.methods.weights.weight_files import WeightFiles


@register("fno")
@dataclass
class Fno(ImageNetworkMethod):
    """A Fourier neural operator that corrects the best linear image, trained like `dnn`."""

    source: ClassVar[str] = "Li et al., ICLR 2021"
    files: ClassVar = WeightFiles("fno")
    recipe: ClassVar = Recipe(epochs=6)
    options: ClassVar = ("limit", "unlimited", "start", "loss")
    backbone: ClassVar = "fno"
