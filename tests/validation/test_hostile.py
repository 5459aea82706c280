"""Any content of a file or a layup gives a record or one clear refusal, no traceback, no warning."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import cpam_bayes as cb
from cpam_bayes.errors import LayupError, PlateFileError
from cpam_bayes.plate import MAX_BYTES, parse_specimen
from cpam_bayes.plate.instruments import MAX_UNIVERSAL_BYTES, UniversalFileError, read_shapes
from cpam_bayes.plate.layup import MAX_PLIES, format_angles, parse_layup
from cpam_bayes.plate.modal_analysis.hits import ModalTestError
from cpam_bayes.plate.modes_of_hits import modes_of
from cpam_bayes.plate.modes_table import read_modes_table
from cpam_bayes.storage import read_arrays, write_arrays
from tests.effort import calls
from validation.hostile import measurements
from validation.hostile.files import DAMAGES, LARGE_FILES, layups, plate_texts

OFF = [HealthCheck.too_slow, HealthCheck.filter_too_much]
UNTIMED = settings(deadline=None, derandomize=True, database=None, suppress_health_check=OFF)
BOUNDED = settings(UNTIMED, max_examples=200)
# Allowed function calls per byte of a file: the parser of the standard library takes about 10.
CALLS_A_BYTE = 60


def is_short_and_printable(said: str) -> bool:
    return len(said) < 1000 and said.isprintable()


def refused(text: str) -> tuple[str, ...]:
    """Problems of a plate file, none if it was accepted."""
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
        assert all(map(is_short_and_printable, problem.splitlines()))


@BOUNDED
@given(layups())
def test_a_layup_is_read_or_refused_with_the_place(text: str) -> None:
    try:
        layup, refusal = parse_layup(text), None
    except LayupError as error:
        layup, refusal = None, error
    if layup is None:
        assert 0 <= refusal.position <= len(text)
        assert all(line.isprintable() for line in str(refusal).splitlines())
        return
    assert 1 <= layup.n_plies <= MAX_PLIES
    if not layup.n_unknown:
        again = parse_layup(format_angles(layup.angles_deg.tolist()))
        np.testing.assert_array_equal(again.angles_deg, layup.angles_deg)


@BOUNDED
@given(measurements.mode_tables())
def test_a_table_of_modes_is_read_or_refused_in_short_printable_lines(text: str) -> None:
    rows, problems = read_modes_table(text)
    modes, problems = (None, problems) if rows is None else modes_of(rows, complete=True)
    assert (modes is None) == bool(problems)
    for problem in problems:
        assert all(map(is_short_and_printable, str(problem).splitlines()))
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
def test_no_damaged_file_is_accepted_and_none_raises(tmp_path: Path, damage, caplog) -> None:
    rng, path = np.random.default_rng(22), tmp_path / "model.arrays"
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


OFF_TOO = [*OFF, HealthCheck.function_scoped_fixture, HealthCheck.data_too_large]
FEWER = settings(BOUNDED, max_examples=100, suppress_health_check=OFF_TOO)
LENGTH, WIDTH = 0.2, 0.1
OF_HITS: dict[str, Any] = {"force": 1, "response": (2,), "window": "exponential"}


def poles_of(path: Path, content: bytes) -> str:
    """Message for a file of a test, empty if its modes are sound."""
    path.write_bytes(content)
    options = OF_HITS if path.suffix == ".wav" else {}
    try:
        result = cb.poles(path, order=10, **options)
    except ModalTestError as refusal:
        return str(refusal)
    for one in result.modes:
        assert np.isfinite([one.frequency, one.sd, one.damping, one.damping_sd]).all()
        assert min(one.frequency, one.damping) > 0.0
    return ""


UNIVERSAL = measurements.universal_response_files().map(lambda content: (".unv", content))
TABLES = measurements.response_tables().map(lambda text: (".csv", text.encode()))
RECORDINGS = measurements.recordings().map(lambda content: (".wav", content))


@FEWER
@given(measurements.universal_modes_files())
def test_modes_of_a_universal_file_are_read_or_refused(content: bytes) -> None:
    found, said = None, ""
    try:
        found = read_shapes(content, LENGTH, WIDTH)
    except UniversalFileError as refusal:
        said = str(refusal)
    if found is None:
        assert said
        assert is_short_and_printable(said)
        return
    assert np.all(np.isfinite(found.frequencies))
    assert np.all(np.diff(found.frequencies) >= 0.0)
    assert np.all(np.isfinite(found.shapes.values))
    assert np.all((found.shapes.points >= 0.0) & (found.shapes.points <= (LENGTH, WIDTH)))


@FEWER
@given(content=st.one_of(UNIVERSAL, TABLES, RECORDINGS))
def test_responses_and_records_have_poles_or_are_refused(tmp_path: Path, content: tuple[str, bytes]) -> None:
    ending, written = content
    said = poles_of(tmp_path / f"tap{ending}", written)
    assert not said or is_short_and_printable(said.replace(str(tmp_path), ""))


# Allowed calls per kB of a file (short universal lines take 200), and per row of a table (cells take 30).
CALLS_A_KB, CALLS_A_ROW = 1000, 50
LARGE_MEASUREMENTS = {**measurements.LARGE_UNIVERSAL_FILES, **measurements.LARGE_TABLES}


@pytest.mark.slow
@pytest.mark.parametrize("name", LARGE_MEASUREMENTS)
def test_a_large_file_of_measurements_takes_an_effort_in_proportion(tmp_path: Path, name: str) -> None:
    is_table = name in measurements.LARGE_TABLES
    content = LARGE_MEASUREMENTS[name](MAX_UNIVERSAL_BYTES // 10)
    most = CALLS_A_KB * len(content) // 1000 + (CALLS_A_ROW * content.count(b"\n") if is_table else 0)
    with calls() as made:
        poles_of(tmp_path / ("tap.csv" if is_table else "tap.unv"), content)
    assert made() < most
    if not is_table:
        with calls() as made, pytest.raises(UniversalFileError):
            read_shapes(content, LENGTH, WIDTH)
        assert made() < most
