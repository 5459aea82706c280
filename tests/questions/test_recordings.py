"""Plates are identified from recordings and from tables of peaks: the plate model picks the modes."""

import json
import shutil
import tomllib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.io import wavfile

import cpam_bayes as cb
from cpam_bayes.answer import FrequencyRow
from cpam_bayes.diagnosis.models import plate_under_test
from cpam_bayes.errors import PlateFileError
from cpam_bayes.inference.pairing import Pairing
from cpam_bayes.plate.modal_analysis.fit import Taken
from cpam_bayes.plate.modal_analysis.peaks import false_peaks, mode_probability
from cpam_bayes.questions.identify.emcee import left_out_peaks
from cpam_bayes.render.spectrum import peak_rows
from tests.plate_file import PLATE
from validation.recorded_hits import RATE, Faults, recorded_hits

# Peaks that are no modes of the aluminium plate of the tests, whose E is 69 GPa.
NO_MODES = (193.0, 420.0)
EXACT = "\n[plate.sd]\nlength_mm = 0\nwidth_mm = 0\nthickness_mm = 0\ndensity_kg_m3 = 0\n"


@pytest.fixture(scope="module")
def plate(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A plate file beside a folder of three hits with hum and two peaks that are no modes."""
    folder = tmp_path_factory.mktemp("recorded")
    (folder / "hits").mkdir()
    modes = [mode.frequency for mode in cb.forward(tomllib.loads(PLATE), n_modes=8).modes]
    f = np.sort(np.append(modes, NO_MODES))
    hits = recorded_hits(np.random.default_rng(11), f, np.full(len(f), 0.006), 3, Faults(hum=0.02))
    for i, hit in enumerate(hits):
        wavfile.write(folder / "hits" / f"{i}.wav", RATE, hit)
    measured = f'recordings = ["hits"]\nrange_hz = [60, {modes[-1] + 15.0:.0f}]\nrelative_std = 0.003\n'
    path = folder / "plate.toml"
    path.write_text(f"{PLATE}{EXACT}[measurement]\n{measured}", encoding="utf-8")
    return path


def test_recordings_beside_a_plate_file_are_candidates_that_are_read_once(
    plate: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(plate.parent.parent)
    measurement = cb.read_plate(Path(plate.parent.name) / "plate.toml").measurement
    assert not measurement.complete
    assert not any(abs(f - hum) < 0.5 for f in measurement.frequencies for hum in (50.0, 150.0))
    assert np.all((measurement.mode_probability >= 0.02) & (measurement.mode_probability <= 0.98))
    assert np.all(measurement.frequency_sd >= 0.003 * measurement.frequencies)
    assert measurement.damping == pytest.approx(0.006, rel=0.2)
    # and again when they change
    copy = shutil.copytree(plate.parent, tmp_path / "copy") / plate.name
    first, again = (cb.read_plate(copy).measurement.test for _ in range(2))
    assert again is first
    (copy.parent / "hits" / "2.wav").unlink()
    assert len(cb.read_plate(copy).measurement.test.responses.each_hit) == 2


def test_a_hit_unlike_the_others_is_a_warning_of_every_answer_about_the_plate(
    plate: Path, tmp_path: Path
) -> None:
    folder = shutil.copytree(plate.parent, tmp_path / "of two plates")
    f = 1.01 * np.array([mode.frequency for mode in cb.forward(tomllib.loads(PLATE), n_modes=8).modes])
    rng = np.random.default_rng(14)
    wavfile.write(folder / "hits" / "3.wav", RATE, recorded_hits(rng, f, np.full(len(f), 0.006), 1)[0])
    warnings = [n for n in cb.forward(folder / "plate.toml").notices if n.code == "unlike_hit"]
    assert [n.facts["hit"] for n in warnings] == [4]
    assert warnings[0].facts["shift"] == pytest.approx(0.01, rel=0.1)


def test_the_model_takes_no_peak_for_a_mode_where_it_has_none(plate: Path) -> None:
    posterior = cb.posterior(cb.read_plate(plate).with_exact_sizes())
    pairing = posterior.most_probable_pairing(np.array([69e9, 0.33]))
    alone = posterior.measurement.frequencies[pairing.mode < 0]
    assert all(np.min(np.abs(alone - f)) < 1.0 for f in NO_MODES)
    assert set(pairing.mode[pairing.mode >= 0]) | set(pairing.missed) == set(range(8))


@pytest.mark.slow
def test_the_model_picks_the_modes_among_the_peaks_in_one_command(run, plate: Path, tmp_path: Path) -> None:
    status, out, _ = run("identify", str(plate), "--seed", "0", "--json", "--out", str(tmp_path / "out"))
    document = json.loads(out)
    assert status == 0
    assert document["backend"] == "emcee"
    e1 = document["constants"]["E1_GPa"]
    assert e1["q025"] < 69.0 < e1["q975"]
    taken = {round(peak["hz"]): peak for peak in document["peaks"]}
    for f in NO_MODES:
        at = min(taken, key=lambda hz: abs(hz - f))
        assert abs(at - f) <= 1
        assert taken[at]["predicted_hz"] is None
        assert taken[at]["taken"] == "no mode"
    paired = [peak for peak in document["peaks"] if peak["predicted_hz"] is not None]
    # the noise of 0.3 % and three or four standard deviations of it
    assert all(abs(peak["predicted_hz"] / peak["hz"] - 1.0) < 0.01 for peak in paired)
    assert all(peak["probability"] > 0.9 for peak in paired)
    assert len(paired) + len(document["missed_modes"]) == 8
    assert "What each peak was taken for" in (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert (tmp_path / "out" / "figures" / "spectrum.svg").exists()


@pytest.fixture
def of_peaks(tmp_path: Path) -> Callable[..., Path]:
    """Write a table of peaks and a plate file that names it, and return the plate file's path."""

    def write(peaks: str, more: str = "") -> Path:
        (tmp_path / "peaks.csv").write_text(peaks, encoding="utf-8")
        path = tmp_path / "plate.toml"
        path.write_text(f'{PLATE}[measurement]\npeaks = "peaks.csv"\n{more}', encoding="utf-8")
        return path

    return write


def test_a_peak_of_its_own_probability_is_a_mode_with_it_where_modes_are_as_dense_as_peaks() -> None:
    q = mode_probability(np.array([0.6, 1.8, 1e9, 1e-9, 0.6]), np.array([1.0, 1.0, 1.0, 1.0, 0.5]))
    np.testing.assert_allclose(q, [0.5, 0.75, 0.98, 0.02, 1.0 / 3.0])
    # a mode anywhere in the range with density (sum q) / range, against a false peak at its price
    np.testing.assert_allclose(q.sum() / (q.sum() + false_peaks(q)), q)


def test_a_table_of_peaks_is_weighed_as_recordings_are(of_peaks) -> None:
    path = of_peaks("hz;sd;height\n300;0,1;9\n114;0,1;3\n218;0,2;0,6\n", "relative_std = 0.01\n")
    found = cb.read_plate(path).measurement
    np.testing.assert_allclose(found.frequencies, [114.0, 218.0, 300.0])
    np.testing.assert_allclose(found.mode_probability, [5.0 / 6.0, 0.5, 15.0 / 16.0])
    np.testing.assert_allclose(found.frequency_sd, np.hypot([0.1, 0.2, 0.1], 0.01 * found.frequencies))
    assert not found.complete
    # heads may be named; numbers with three decimals, not in order
    named = of_peaks(
        "f0;h\n115,673;10\n165,530;20\n99,570;20\n", '[measurement.columns]\nhz = "f0"\nheight = "h"\n'
    )
    np.testing.assert_allclose(cb.read_plate(named).measurement.frequencies, [99.57, 115.673, 165.53])


def test_a_peak_that_stands_out_and_is_taken_for_no_mode_is_named(of_peaks) -> None:
    measurement = cb.read_plate(of_peaks("hz,sd,height\n114,1,30\n218,2,30\n300,3,0.6\n")).measurement

    def named(*mode: int) -> list[tuple[float, ...]]:
        pairing = Pairing(np.array(mode), np.array([], dtype=int), 0.0)
        return [notice.facts["peaks"] for notice in left_out_peaks(measurement, pairing)]

    assert named(0, -1, -1) == [(218.0,)]
    assert named(0, 1, -1) == []


def test_an_unpaired_peak_of_double_hits_is_said_to_be_of_the_second_hit(plate: Path) -> None:
    measurement = cb.read_plate(plate).measurement
    f = float(measurement.frequencies[1])
    poles = (replace(p, taken=Taken.SECOND_HIT) if p.frequency == f else p for p in measurement.test.poles)
    changed = replace(measurement, test=replace(measurement.test, poles=tuple(poles)))
    peaks = peak_rows(changed, [FrequencyRow(float(one), None) for one in measurement.frequencies])
    taken = {peak["hz"]: peak["taken"] for peak in peaks.records()}
    assert {hz for hz, said in taken.items() if said == "second hit"} == {f}


@pytest.mark.parametrize("damping", [("0.002", "0.003", "0.01"), ("0", "0.003", "0")])
def test_measured_damping_reaches_the_causes(of_peaks, damping: tuple[str, ...]) -> None:
    one, two, three = damping
    path = of_peaks(f"hz,sd,height,damping\n114,1,3,{one}\n166,1,3,{two}\n218,2,3,{three}\n")
    converged, _ = plate_under_test(cb.read_plate(path), 3)
    assert converged.facts.loss_factor == pytest.approx(0.006)


def test_a_candidate_that_is_left_out_takes_what_belongs_to_it_along(of_peaks) -> None:
    peaks = "hz,sd,height\n114,1,3\n218,2,0.6\n300,3,9\n"
    every = cb.read_plate(of_peaks(peaks)).measurement
    path = of_peaks(peaks, "left_out = [2]\n")
    left = cb.read_plate(path).measurement
    np.testing.assert_array_equal(left.frequencies, [114.0, 300.0])
    np.testing.assert_array_equal(left.mode_probability, every.mode_probability[[0, 2]])
    np.testing.assert_array_equal(left.false_peaks, every.false_peaks[[0, 2]])
    assert cb.posterior(path).pairing.spurious == tuple(left.false_peaks)


WITHOUT_HEIGHT = "hz,sd\n100,0.1\n"


@pytest.mark.parametrize(
    ("measured", "peaks", "said"),
    [
        ('recordings = ["none.wav"]', None, r"measurement\.recordings: .*none\.wav: no such file or folder"),
        ('recordings = ["noise.wav"]', None, r"measurement\.recordings: .*noise\.wav: not a \.wav file"),
        ("recordings = []", None, "measurement.recordings: wrong length"),
        ('recordings = ["empty"]', None, "no recordings in this folder"),
        ('recordings = ["noise.wav"]\nlabels = [""]', None, "beside candidate peaks, accepted: no labels"),
        ('peaks = "peaks.csv"\nrange_hz = [1, 2]', WITHOUT_HEIGHT, "beside no recordings"),
        (
            'peaks = "peaks.csv"\nfrequencies_hz = [100]',
            WITHOUT_HEIGHT,
            "one of frequencies_hz, table, recordings, peaks",
        ),
        ('recordings = ["folder"]', None, "no such file or folder"),
        ('peaks = "peaks.csv"', None, r"measurement\.peaks: no such file"),
        ('peaks = "peaks.csv"', WITHOUT_HEIGHT, "line 2, column height: no height"),
        (
            'peaks = "peaks.csv"',
            "hz,height\n114.7,20\n164.7,9\n114.7,20\n",
            r"peaks\.csv line 4, column hz: received 114\.7 Hz as in line 2",
        ),
        ('peaks = "peaks.csv"', "hz,height\nnan,3\n", r"peaks\.csv line 2, column hz: no frequency"),
        (
            'peaks = "peaks.csv"',
            "hz,height [dB]\n114.7,26\n164.7,20\n",
            r"peaks\.csv column height: unknown unit db, accepted: a height above 0, of the peak",
        ),
        (
            'peaks = "peaks.csv"',
            "hz,height\n114.7,-3\n164.7,-15\n",
            r"peaks\.csv line 2, column height: .*received -3, accepted: a height above 0",
        ),
    ],
)
def test_what_cannot_be_read_is_one_clear_error(
    tmp_path: Path, measured: str, peaks: str | None, said: str
) -> None:
    (tmp_path / "noise.wav").write_bytes(b"no sound")
    (tmp_path / "empty").mkdir()
    if peaks is not None:
        (tmp_path / "peaks.csv").write_text(peaks, encoding="utf-8")
    path = tmp_path / "plate.toml"
    path.write_text(f"{PLATE}[measurement]\n{measured}\n", encoding="utf-8")
    with pytest.raises(PlateFileError, match=said):
        cb.read_plate(path)
