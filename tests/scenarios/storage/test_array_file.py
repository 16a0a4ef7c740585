"""Files of arrays: they come back as they were, or a sentence says why not."""

from pathlib import Path

import numpy as np

from eitbench.scenarios.storage.array_file import read_arrays, write_arrays


def test_stored_arrays_come_back_as_they_were(tmp_path: Path) -> None:
    arrays = {"a": np.arange(6.0).reshape(2, 3).T, "b": np.array(3), "c": np.zeros((0, 2))}
    path = tmp_path / "new" / "x.safetensors"
    assert read_arrays(path) is None
    write_arrays(path, arrays, {"made": "here"})
    found = read_arrays(path)
    assert found is not None
    assert found[1] == {"made": "here"}
    assert all(np.array_equal(found[0][name], array) for name, array in arrays.items())
    assert {name: array.dtype for name, array in found[0].items()} == {
        name: array.dtype for name, array in arrays.items()
    }
    assert [p.name for p in path.parent.iterdir()] == [path.name]
