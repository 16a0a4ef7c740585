"""Our reader of MATLAB files beside SciPy's, and the files that it refuses."""

import zlib
from pathlib import Path

import numpy as np
import pytest
from scipy.io import loadmat, savemat

from eitbench.scenarios.errors import DataCorruptError
from eitbench.scenarios.recordings.matlab import variables

RNG = np.random.default_rng(3)
ARRAYS = {
    kind: (RNG.normal(size=(7, 5)) * 100).astype(kind)
    for kind in ("f8", "f4", "i1", "u1", "i2", "u2", "i4", "u4", "i8", "u8")
} | {
    "one": np.array([[2.5]]),
    "logical": np.array([[True, False, True]]),
    "cube": RNG.normal(size=(2, 3, 4)),
    "none": np.zeros((0, 4)),
    "complex": RNG.normal(size=(3, 2)) + 1j * RNG.normal(size=(3, 2)),
    "complex_single": np.array([[1 + 2j, 3]], dtype=np.complex64),
    "tiny": np.array([[1, 2]], dtype=np.uint8),
}
OTHERS = {"cells": np.array([[1], "a"], dtype=object), "text": "öäü 1"}


@pytest.mark.parametrize("compressed", [True, False])
def test_it_agrees_with_scipy(tmp_path: Path, compressed: bool) -> None:
    path = tmp_path / "data.mat"
    named = {f"v_{name}": array for name, array in ARRAYS.items()} | OTHERS
    savemat(path, named, do_compression=compressed, oned_as="column")
    expected, found = loadmat(path), variables(path, named)
    assert found.pop("text") == "öäü 1" == expected["text"][0]
    assert set(found) == {f"v_{name}" for name in ARRAYS}
    for name, array in found.items():
        assert isinstance(array, np.ndarray)
        assert array.dtype == expected[name].dtype
        np.testing.assert_array_equal(array, expected[name], strict=True)


def test_a_matrix_of_characters_is_lines(tmp_path: Path) -> None:
    path = tmp_path / "data.mat"
    savemat(path, {"a": np.array(["one", "", "drei ü"]), "b": np.array(["alone"]), "c": [""]})
    found = variables(path)
    assert isinstance(found["a"], np.ndarray)
    assert found["a"].tolist() == ["one", "", "drei ü"]
    assert found["b"] == "alone"


def test_only_what_is_asked_for_is_read(tmp_path: Path) -> None:
    savemat(tmp_path / "data.mat", {"a": [1.0], "b": [2.0]})
    assert set(variables(tmp_path / "data.mat", ["b"])) == {"b"}


def test_a_bomb_is_not_unpacked(tmp_path: Path) -> None:
    """64 MB of zeros compress to 64 kB."""
    plain, bomb = tmp_path / "plain.mat", tmp_path / "bomb.mat"
    savemat(plain, {"values": np.zeros((2, 2))})
    content = zlib.compress(bytes(2**26))
    head = plain.read_bytes()[:128]
    bomb.write_bytes(head + (15).to_bytes(4, "little") + len(content).to_bytes(4, "little"))
    with bomb.open("ab") as file:
        file.write(content)
    with pytest.raises(DataCorruptError, match="much larger than the file"):
        variables(bomb, ["values"])
