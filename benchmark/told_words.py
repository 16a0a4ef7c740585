"""What a method was told, in words."""

import json

_NOISE = {"tuning": "tuning", "train": "training data", "validation": "validation data"}


def in_words(told: str) -> str:
    """The column `told` of a cell as people read it; "" where it is not known."""
    if not told:
        return ""
    content = json.loads(told)
    noise = [_NOISE[where] for where in content["noise"]]
    said = []
    if content["model"]:
        said.append("nominal contact impedance")
    if content["conductivity_range"]:
        said.append("conductivity range")
    if noise:
        said.append(f"noise level through {' and '.join(noise)}")
    if content["tuned"]:
        said.append(f"{content['tuned']['trials']} trials of tuning")
    for given in content["given"]:
        kind = "training" if given["split"] == "train" else given["split"]
        said.append(f"{given['samples']:,} {kind} samples")
    if content["trained_on"]:
        said.append(f"weights of {int(content['trained_on']['train_samples']):,} training samples")
    return "; ".join(said) or "the untouched frame only"
