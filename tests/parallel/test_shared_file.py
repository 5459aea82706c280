"""What is shared through a file is what was written, and large arrays are in memory once."""

from pathlib import Path

import numpy as np
import pytest

from cpam_bayes.parallel.shared_file import copied, read_shared, write_shared

LARGE = np.arange(1 << 19, dtype=float).reshape(-1, 64)
SMALL = np.arange(3)


def written(value: object, path: Path) -> Path:
    with path.open("wb") as file:
        write_shared(value, file)
    return path


@pytest.mark.parametrize(
    "array", [LARGE, LARGE.T, LARGE[:, ::2], LARGE.astype(np.int32), SMALL, np.empty((0, 4))]
)
def test_arrays_of_any_order_size_and_type_come_back(array: np.ndarray, tmp_path: Path) -> None:
    found = read_shared(written({"name": [array, SMALL, array + 1]}, tmp_path / "shared"))
    for one, expected in zip(found["name"], (array, SMALL, array + 1), strict=True):
        assert one.dtype == expected.dtype
        np.testing.assert_array_equal(one, expected)


def test_an_object_without_arrays_comes_back(tmp_path: Path) -> None:
    assert read_shared(written({"a": (1, "b")}, tmp_path / "shared")) == {"a": (1, "b")}


def test_the_arrays_outlive_the_name_of_the_file(tmp_path: Path) -> None:
    path = written(LARGE, tmp_path / "shared")
    found = read_shared(path)
    path.unlink()
    np.testing.assert_array_equal(found, LARGE)


def test_who_writes_into_a_shared_array_has_a_copy(tmp_path: Path) -> None:
    path = written(LARGE, tmp_path / "shared")
    one, other = read_shared(path), read_shared(path)
    one[0] = -1.0
    np.testing.assert_array_equal(other, LARGE)
    np.testing.assert_array_equal(read_shared(path), LARGE)


def test_a_copy_in_this_process_shares_nothing() -> None:
    small, large = copied((SMALL, LARGE))
    assert not np.shares_memory(large, LARGE)
    assert not np.shares_memory(small, SMALL)
    large[0] = -1.0
    np.testing.assert_array_equal(LARGE[0], np.arange(64.0))


def test_the_pickle_beside_a_large_array_is_small(tmp_path: Path) -> None:
    path = written((LARGE, LARGE), tmp_path / "shared")
    assert path.stat().st_size < LARGE.nbytes + 1000, "the same array twice is written once"
