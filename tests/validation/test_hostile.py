"""Whatever is written into a plate file or a layup: a record or one clear refusal, never a traceback."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings

from cpam_bayes.errors import LayupError, PlateFileError
from cpam_bayes.plate import MAX_BYTES, parse_specimen
from cpam_bayes.plate.layup import MAX_PLIES, format_angles, parse_layup
from cpam_bayes.plate.modes_table import modes_of, read_modes_table
from cpam_bayes.storage import read_arrays, write_arrays
from tests.effort import calls
from validation.hostile.files import DAMAGES, LARGE_FILES, layups, plate_texts
from validation.hostile.measurements import mode_tables

BOUNDED = settings(
    max_examples=200,
    deadline=None,
    derandomize=True,
    database=None,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.filter_too_much],
)
# Functions called for each byte of a file: the parser of the standard library takes about 10.
CALLS_A_BYTE = 60


def refused(text: str) -> tuple[str, ...]:
    """What is said of a plate file, nothing where it was accepted."""
    try:
        parse_specimen(text, "plate.toml")
    except PlateFileError as refusal:
        return refusal.problems or ("refused without a word",)
    return ()


@BOUNDED
@given(plate_texts())
def test_a_plate_file_is_read_or_refused_in_short_printable_lines(text: str) -> None:
    for problem in refused(text):
        assert problem.startswith("plate.toml:")
        assert all(line.isprintable() and len(line) < 1000 for line in problem.splitlines())


@BOUNDED
@given(layups())
def test_a_layup_is_read_or_refused_with_the_place(text: str) -> None:
    try:
        layup, refusal = parse_layup(text), None
    except LayupError as error:
        layup, refusal = None, error
    if refusal is not None:
        assert 0 <= refusal.position <= len(text)
        assert all(line.isprintable() for line in str(refusal).splitlines())
    if layup is not None:
        assert 1 <= layup.n_plies <= MAX_PLIES
    if layup is not None and not layup.n_unknown:
        again = parse_layup(format_angles(layup.angles_deg.tolist()))
        np.testing.assert_array_equal(again.angles_deg, layup.angles_deg)


@BOUNDED
@given(mode_tables())
def test_a_table_of_modes_is_read_or_refused_in_short_printable_lines(text: str) -> None:
    rows, problems = read_modes_table(text)
    modes = None
    if rows is not None:
        modes, problems = modes_of(rows, complete=True)
    assert (modes is None) == bool(problems)
    for problem in problems:
        assert all(line.isprintable() and len(line) < 1000 for line in str(problem).splitlines())
    if modes is not None:
        assert np.all(np.diff(modes.frequencies) >= 0.0)
        assert np.all(np.isfinite(modes.frequencies))
        assert np.all(modes.frequencies > 0.0)
        assert modes.sd is None or np.all(np.isfinite(modes.sd))


@pytest.mark.slow
@pytest.mark.parametrize("name", LARGE_FILES)
def test_a_file_as_large_as_allowed_is_refused_with_an_effort_in_proportion(name: str) -> None:
    text = LARGE_FILES[name]
    assert 0.3 * MAX_BYTES < len(text.encode()) <= MAX_BYTES
    with calls() as made:
        problems = refused(text)
    assert 0 < len(problems) <= 101
    assert made() < CALLS_A_BYTE * len(text)


@pytest.mark.parametrize("damage", DAMAGES.values(), ids=DAMAGES)
def test_no_damaged_file_is_accepted_and_none_raises(
    tmp_path: Path, damage: Callable[[bytes, np.random.Generator], bytes], caplog: pytest.LogCaptureFixture
) -> None:
    rng = np.random.default_rng(22)
    path = tmp_path / "model.arrays"
    write_arrays(path, {"stack": np.arange(60.0).reshape(3, 4, 5), "name": np.array("a text")})
    whole = path.read_bytes()
    for _ in range(200):
        content = damage(whole, rng)
        if content == whole:
            continue
        path.write_bytes(content)
        caplog.clear()
        assert read_arrays(path) is None
        assert [str(path) in said for said in caplog.messages] == [True]
        assert not path.exists()
        assert (tmp_path / "model.arrays.damaged").read_bytes() == content
