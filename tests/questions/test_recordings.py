"""Plates are identified from recordings and from tables of peaks: the plate model picks the modes."""

import json
import shutil
import tomllib
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

# Peaks that are no modes of the tests' aluminium plate, whose E is 69 GPa.
NO_MODES = (193.0, 420.0)
EXACT = "\n[plate.sd]\nlength_mm = 0\nwidth_mm = 0\nthickness_mm = 0\ndensity_kg_m3 = 0\n"


@pytest.fixture(scope="module")
def modes():
    return cb.forward(tomllib.loads(PLATE), n_modes=8).frequencies


@pytest.fixture(scope="module")
def plate(tmp_path_factory, modes):
    """A plate file beside a folder of three hits with hum and two peaks that are no modes."""
    path = tmp_path_factory.mktemp("recorded") / "plate.toml"
    (path.parent / "hits").mkdir()
    f = np.sort(np.append(modes, NO_MODES))
    hits = recorded_hits(np.random.default_rng(11), f, np.full(len(f), 0.006), 3, Faults(hum=0.02))
    for i, hit in enumerate(hits):
        wavfile.write(path.parent / "hits" / f"{i}.wav", RATE, hit)
    measured = f'recordings = ["hits"]\nrange_hz = [60, {modes[-1] + 15.0:.0f}]\nrelative_std = 0.003\n'
    path.write_text(f"{PLATE}{EXACT}[measurement]\n{measured}", encoding="utf-8")
    return path


def test_recordings_beside_a_plate_file_are_candidates_that_are_read_once(plate, tmp_path, monkeypatch):
    monkeypatch.chdir(plate.parent.parent)
    measurement = cb.read_plate(Path(plate.parent.name) / "plate.toml").measurement
    assert not measurement.complete
    assert not any(abs(f - hum) < 0.5 for f in measurement.frequencies for hum in (50.0, 150.0))
    assert np.all((measurement.mode_probability >= 0.02) & (measurement.mode_probability <= 0.98))
    assert np.all(measurement.frequency_sd >= 0.003 * measurement.frequencies)
    assert measurement.damping == pytest.approx(0.006, rel=0.2)
    copy = shutil.copytree(plate.parent, tmp_path / "copy") / plate.name  # and again when they change
    first, again = (cb.read_plate(copy).measurement.test for _ in range(2))
    assert again is first
    (copy.parent / "hits" / "2.wav").unlink()
    assert len(cb.read_plate(copy).measurement.test.responses.each_hit) == 2


def test_a_hit_unlike_the_others_is_a_warning_of_every_answer_about_the_plate(plate, modes, tmp_path):
    folder, rng = shutil.copytree(plate.parent, tmp_path / "of two plates"), np.random.default_rng(14)
    (hit,) = recorded_hits(rng, 1.01 * modes, np.full(len(modes), 0.006), 1)
    wavfile.write(folder / "hits" / "3.wav", RATE, hit)
    facts = [n.facts for n in cb.forward(folder / "plate.toml").notices if n.code == "unlike_hit"]
    assert facts == [{"hit": 4, "shift": pytest.approx(0.01, rel=0.1)}]


def test_the_model_takes_no_peak_for_a_mode_where_it_has_none(plate):
    posterior = cb.posterior(cb.read_plate(plate).with_exact_sizes())
    pairing = posterior.most_probable_pairing(np.array([69e9, 0.33]))
    alone = posterior.measurement.frequencies[pairing.mode < 0]
    assert all(np.min(np.abs(alone - f)) < 1.0 for f in NO_MODES)
    assert set(pairing.mode[pairing.mode >= 0]) | set(pairing.missed) == set(range(8))


@pytest.mark.slow
def test_the_model_picks_the_modes_among_the_peaks_in_one_command(run, plate, tmp_path):
    out = tmp_path / "out"
    status, text, _ = run("identify", plate, "--seed", "0", "--json", "--out", out)
    document = json.loads(text)
    assert (status, document["backend"]) == (0, "emcee")
    e1 = document["constants"]["E1_GPa"]
    assert e1["q025"] < 69.0 < e1["q975"]
    for f in NO_MODES:
        peak = min(document["peaks"], key=lambda peak: abs(peak["hz"] - f))
        assert abs(round(peak["hz"]) - f) <= 1
        assert (peak["predicted_hz"], peak["taken"]) == (None, "no mode")
    paired = [peak for peak in document["peaks"] if peak["predicted_hz"] is not None]
    for peak in paired:
        assert abs(peak["predicted_hz"] / peak["hz"] - 1.0) < 0.01  # the noise of 0.3 %, times three or four
        assert peak["probability"] > 0.9
    assert len(paired) + len(document["missed_modes"]) == 8
    assert "What each peak is" in (out / "report.html").read_text(encoding="utf-8")
    assert (out / "figures" / "spectrum.svg").exists()


@pytest.fixture
def of_peaks(tmp_path):
    def write(peaks, more=""):
        (tmp_path / "peaks.csv").write_text(peaks, encoding="utf-8")
        path = tmp_path / "plate.toml"
        path.write_text(f'{PLATE}[measurement]\npeaks = "peaks.csv"\n{more}', encoding="utf-8")
        return path

    return write


def test_a_table_of_peaks_is_weighed_by_heights_as_recordings_are(of_peaks):
    q = mode_probability(np.array([0.6, 1.8, 1e9, 1e-9, 0.6]), np.array([1.0, 1.0, 1.0, 1.0, 0.5]))
    np.testing.assert_allclose(q, [0.5, 0.75, 0.98, 0.02, 1.0 / 3.0])
    # a mode anywhere in the range with density (sum q) / range, against a false peak at its price
    np.testing.assert_allclose(q.sum() / (q.sum() + false_peaks(q)), q)
    path = of_peaks("hz;sd;height\n300;0,1;9\n114;0,1;3\n218;0,2;0,6\n", "relative_std = 0.01\n")
    found = cb.read_plate(path).measurement
    np.testing.assert_allclose(found.frequencies, [114.0, 218.0, 300.0])
    np.testing.assert_allclose(found.mode_probability, [5.0 / 6.0, 0.5, 15.0 / 16.0])
    np.testing.assert_allclose(found.frequency_sd, np.hypot([0.1, 0.2, 0.1], 0.01 * found.frequencies))
    assert not found.complete
    # headings may be named; three decimals, unsorted
    heads = '[measurement.columns]\nhz = "f0"\nheight = "h"\n'
    named = cb.read_plate(of_peaks("f0;h\n115,673;10\n165,530;20\n99,570;20\n", heads)).measurement
    np.testing.assert_allclose(named.frequencies, [99.57, 115.673, 165.53])


def test_a_peak_that_stands_out_and_is_taken_for_no_mode_is_named(of_peaks):
    measurement = cb.read_plate(of_peaks("hz,sd,height\n114,1,30\n218,2,30\n300,3,0.6\n")).measurement
    for mode, peaks in (([0, -1, -1], [(218.0,)]), ([0, 1, -1], [])):
        pairing = Pairing(np.array(mode), np.array([], dtype=int), 0.0)
        assert [notice.facts["peaks"] for notice in left_out_peaks(measurement, pairing)] == peaks


def test_an_unpaired_peak_of_double_hits_is_said_to_be_of_the_second_hit(plate):
    measurement = cb.read_plate(plate).measurement
    f = float(measurement.frequencies[1])
    poles = (replace(p, taken=Taken.SECOND_HIT) if p.frequency == f else p for p in measurement.test.poles)
    changed = replace(measurement, test=replace(measurement.test, poles=tuple(poles)))
    peaks = peak_rows(changed, [FrequencyRow(float(one), None) for one in measurement.frequencies])
    taken = {peak["hz"]: peak["taken"] for peak in peaks.records()}
    assert {hz for hz, said in taken.items() if said == "second hit"} == {f}


@pytest.mark.parametrize("damping", [("0.002", "0.003", "0.01"), ("0", "0.003", "0")])
def test_measured_damping_reaches_the_causes(of_peaks, damping):
    path = of_peaks("hz,sd,height,damping\n114,1,3,{}\n166,1,3,{}\n218,2,3,{}\n".format(*damping))
    converged, _ = plate_under_test(cb.read_plate(path), 3)
    assert converged.facts.loss_factor == pytest.approx(0.006)


def test_a_candidate_that_is_left_out_takes_what_belongs_to_it_along(of_peaks):
    peaks = "hz,sd,height\n114,1,3\n218,2,0.6\n300,3,9\n"
    every = cb.read_plate(of_peaks(peaks)).measurement
    path = of_peaks(peaks, "left_out = [2]\n")
    left = cb.read_plate(path).measurement
    np.testing.assert_array_equal(left.frequencies, [114.0, 300.0])
    np.testing.assert_array_equal(left.mode_probability, every.mode_probability[[0, 2]])
    np.testing.assert_array_equal(left.false_peaks, every.false_peaks[[0, 2]])
    assert cb.posterior(path).pairing.spurious == tuple(left.false_peaks)


PEAKS, WITHOUT_HEIGHT = 'peaks = "peaks.csv"', "hz,sd\n100,0.1\n"
IN_DB, BELOW_0 = "hz,height [dB]\n114.7,26\n164.7,20\n", "hz,height\n114.7,-3\n164.7,-15\n"
DOUBLE = "hz,height\n114.7,20\n164.7,9\n114.7,20\n"


@pytest.mark.parametrize(
    ("measured", "peaks", "said"),
    [
        ('recordings = ["none.wav"]', None, r"measurement\.recordings: .*none\.wav: no such file or folder"),
        ('recordings = ["noise.wav"]', None, r"measurement\.recordings: .*noise\.wav: not a \.wav file"),
        ("recordings = []", None, "measurement.recordings: wrong length"),
        ('recordings = ["empty"]', None, "no recordings in this folder"),
        ('recordings = ["noise.wav"]\nlabels = [""]', None, "beside candidate peaks, accepted: no labels"),
        (f"{PEAKS}\nrange_hz = [1, 2]", WITHOUT_HEIGHT, "beside no recordings"),
        (f"{PEAKS}\nfrequencies_hz = [9]", WITHOUT_HEIGHT, "one of frequencies_hz, table, recordings, peaks"),
        ('recordings = ["folder"]', None, "no such file or folder"),
        (PEAKS, None, r"measurement\.peaks: no such file"),
        (PEAKS, WITHOUT_HEIGHT, "line 2, column height: no height"),
        (PEAKS, DOUBLE, r"peaks\.csv line 4, column hz: received 114\.7 Hz as in line 2"),
        (PEAKS, "hz,height\nnan,3\n", r"peaks\.csv line 2, column hz: no frequency"),
        (PEAKS, IN_DB, r"peaks\.csv column height: unknown unit db, accepted: a height above 0, of the peak"),
        (PEAKS, BELOW_0, r"peaks\.csv line 2, column height: .*received -3, accepted: a height above 0"),
    ],
)
def test_what_cannot_be_read_is_one_clear_error(tmp_path, measured, peaks, said):
    (tmp_path / "noise.wav").write_bytes(b"no sound")
    (tmp_path / "empty").mkdir()
    if peaks is not None:
        (tmp_path / "peaks.csv").write_text(peaks, encoding="utf-8")
    path = tmp_path / "plate.toml"
    path.write_text(f"{PLATE}[measurement]\n{measured}\n", encoding="utf-8")
    with pytest.raises(PlateFileError, match=said):
        cb.read_plate(path)
