"""The prior knowledge of a method, as people read it."""

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


class _Account(BaseModel):
    """The part of `eitbench.benchmark.run.prior_knowledge.account` that is put in words."""

    model: bool
    conductivity_range: bool
    noise: list[Literal["tuning", "train", "validation"]]
    tuned: _Tuned
    given: list[_Given]
    trained_on: _Weights


def describe_prior_knowledge(account: object) -> str:
    """Return the column `prior_knowledge` of a cell as a phrase; "" where it holds no text.

    Raises:
        ValueError: its text is no such account.
    """
    if not isinstance(account, str) or not account:
        return ""
    known = _Account.model_validate_json(account)
    parts = []
    if known.model:
        parts.append("nominal contact impedance")
    if known.conductivity_range:
        parts.append("conductivity range")
    if known.noise:
        parts.append(f"noise level through {' and '.join(_NOISE[way] for way in known.noise)}")
    if known.tuned.trials:
        parts.append(f"{known.tuned.trials} trials of tuning")
    for given in known.given:
        kind = "training" if given.split == "train" else given.split
        parts.append(f"{given.samples:,} {kind} samples")
    if known.trained_on.train_samples:
        parts.append(f"weights of {known.trained_on.train_samples:,} training samples")
    return "; ".join(parts) or "the reference frame only"
