"""Whatever stands in a file of a modal test: modes or one clear refusal, never a traceback or a warning."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import cpam_bayes as cb
from cpam_bayes.modal_analysis.read import ModalTestError
from cpam_bayes.plate.instruments import MAX_UNIVERSAL_BYTES, UniversalFileError, read_shapes
from tests.effort import calls
from validation.hostile.files import crossed
from validation.hostile.measurements import (
    LARGE_TABLES,
    LARGE_UNIVERSAL_FILES,
    recordings,
    response_tables,
    universal_modes_files,
    universal_response_files,
)

BOUNDED = settings(
    max_examples=100,
    deadline=None,
    derandomize=True,
    database=None,
    suppress_health_check=[
        HealthCheck.too_slow,
        HealthCheck.filter_too_much,
        HealthCheck.function_scoped_fixture,
        HealthCheck.data_too_large,
    ],
)
LENGTH, WIDTH = 0.2, 0.1
OF_HITS: dict[str, Any] = {"force": 1, "response": (2,), "window": "exponential"}


def is_short_and_printable(said: str) -> bool:
    return 0 < len(said) < 1000 and said.isprintable()


def poles_of(path: Path, content: bytes) -> str:
    """What is said of a file of a test, nothing where its modes are sound."""
    path.write_bytes(content)
    options = OF_HITS if path.suffix == ".wav" else {}
    try:
        result = cb.poles(path, order=10, **options)
    except ModalTestError as refusal:
        return str(refusal)
    assert all(
        np.isfinite([one.frequency, one.sd, one.damping, one.damping_sd]).all() for one in result.modes
    )
    assert all(one.frequency > 0.0 and one.damping > 0.0 for one in result.modes)
    return ""


@BOUNDED
@given(universal_modes_files())
def test_modes_of_a_universal_file_are_read_or_refused(content: bytes) -> None:
    found, said = None, ""
    try:
        found = read_shapes(content, LENGTH, WIDTH)
    except UniversalFileError as refusal:
        said = str(refusal)
    if found is None:
        assert is_short_and_printable(said)
        return
    assert np.all(np.isfinite(found.frequencies))
    assert np.all(np.diff(found.frequencies) >= 0.0)
    assert np.all(np.isfinite(found.shapes.values))
    assert np.all((found.shapes.points >= 0.0) & (found.shapes.points <= (LENGTH, WIDTH)))


@BOUNDED
@given(content=st.one_of(universal_response_files().map(lambda c: (".unv", c)),
                         response_tables().map(lambda text: (".csv", text.encode())),
                         recordings().map(lambda c: (".wav", c))))  # fmt: skip
def test_responses_and_records_have_poles_or_are_refused(tmp_path: Path, content: tuple[str, bytes]) -> None:
    ending, written = content
    said = poles_of(tmp_path / f"tap{ending}", written)
    assert not said or is_short_and_printable(said.replace(str(tmp_path), ""))


def test_pieces_of_two_files_make_others_of_a_bounded_size() -> None:
    rng = np.random.default_rng(0)
    one, other = b"a\nbb\nccc\n" * 20, b"1,2,3\n" * 50
    made = [crossed(one, other, rng) for _ in range(200)]
    assert len(set(made)) > 150
    assert max(map(len, made)) <= 2 * max(len(one), len(other))
    assert {type(crossed(text, "", rng)) for text in ("", "[0/90]_s")} == {str}


# Functions called for each kB of a file, where reading short lines of universal files takes some 200, and for
# each row of a table, where splitting it into cells takes some 30.
CALLS_A_KB, CALLS_A_ROW = 1000, 50


@pytest.mark.slow
@pytest.mark.parametrize("name", LARGE_UNIVERSAL_FILES)
def test_a_large_universal_file_takes_an_effort_in_proportion(tmp_path: Path, name: str) -> None:
    content = LARGE_UNIVERSAL_FILES[name](MAX_UNIVERSAL_BYTES // 10)
    with calls() as made, pytest.raises(UniversalFileError):
        read_shapes(content, LENGTH, WIDTH)
    assert made() < CALLS_A_KB * len(content) // 1000
    with calls() as made:
        poles_of(tmp_path / "tap.unv", content)
    assert made() < CALLS_A_KB * len(content) // 1000


@pytest.mark.slow
@pytest.mark.parametrize("name", LARGE_TABLES)
def test_a_large_table_of_responses_takes_an_effort_in_proportion(tmp_path: Path, name: str) -> None:
    content = LARGE_TABLES[name](MAX_UNIVERSAL_BYTES // 10)
    with calls() as made:
        poles_of(tmp_path / "tap.csv", content)
    assert made() < CALLS_A_KB * len(content) // 1000 + CALLS_A_ROW * content.count(b"\n")
