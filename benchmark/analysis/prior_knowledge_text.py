"""What a method was told, in words."""

from typing import Literal

from pydantic import BaseModel

_NOISE = {"tuning": "tuning", "train": "training data", "validation": "validation data"}


class _Given(BaseModel):
    split: str
    samples: int


class _Tuned(BaseModel):
    trials: int = 0


class _Weights(BaseModel):
    train_samples: int = 0


class _Told(BaseModel):
    """The part of `eitbench.benchmark.run.prior_knowledge.account` that is put in words."""

    model: bool
    conductivity_range: bool
    noise: list[Literal["tuning", "train", "validation"]]
    tuned: _Tuned
    given: list[_Given]
    trained_on: _Weights


def in_words(told: str) -> str:
    """The column `prior_knowledge` of a cell as people read it; "" where it is not known.

    Raises:
        ValueError: it is no such account.
    """
    if not told:
        return ""
    content = _Told.model_validate_json(told)
    said = []
    if content.model:
        said.append("nominal contact impedance")
    if content.conductivity_range:
        said.append("conductivity range")
    if content.noise:
        said.append(f"noise level through {' and '.join(_NOISE[w] for w in content.noise)}")
    if content.tuned.trials:
        said.append(f"{content.tuned.trials} trials of tuning")
    for given in content.given:
        kind = "training" if given.split == "train" else given.split
        said.append(f"{given.samples:,} {kind} samples")
    if content.trained_on.train_samples:
        said.append(f"weights of {content.trained_on.train_samples:,} training samples")
    return "; ".join(said) or "the reference frame only"
