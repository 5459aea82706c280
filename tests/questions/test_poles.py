"""Poles of known tests lie within their stated standard deviations, from every format that is read."""

from __future__ import annotations

import io
import json

import numpy as np
import pytest
import pyuff
from scipy.io import wavfile

import cpam_bayes as cb
from cpam_bayes.answer import Notice
from cpam_bayes.plate.modal_analysis.fit import Pole, Taken, fit_poles, is_of_mains, modes_of_hits, stabilise
from cpam_bayes.plate.modal_analysis.hits import FrequencyResponses, ModalTestError, hum_notices
from cpam_bayes.plate.modal_analysis.peaks import mode_probability
from tests.plate_file import OF_TABLE
from tests.synthetic_poles import accelerance, eigenvalues, known_test
from validation.recorded_hits import ABOVE, Faults, recorded_hits
from validation.recorded_hits import RATE as RATE_OF_HITS

FREQUENCIES, DAMPING = np.array([81.0, 147.3, 149.6, 220.4, 311.0]), np.array([5, 4, 5, 6, 3]) * 1e-3
LINES = np.arange(0.5, 400.0, 0.5)


def responses(noise=1e-3, n_responses=2, seed=0):
    rng, s = np.random.default_rng(seed), eigenvalues(FREQUENCIES, DAMPING)
    frf = accelerance(LINES, s, rng.uniform(0.5, 1.5, (n_responses, len(s))) / (2j * s.imag))
    sd = noise * np.abs(frf).max()
    frf = frf + sd * (rng.standard_normal(frf.shape) + 1j * rng.standard_normal(frf.shape))
    return FrequencyResponses(LINES, frf, 0.0, "synthetic")


def assert_known(modes, within=4.0, rtol=0.0):
    """Check the five modes within this many standard deviations; at four, one in 3000 fails by chance."""
    assert len(modes) == len(FREQUENCIES)
    for mode, f, damping in zip(modes, FREQUENCIES, DAMPING, strict=True):
        assert abs(mode.frequency - f) < within * mode.sd + rtol * f
        assert abs(mode.damping - damping) < within * mode.damping_sd + 20.0 * rtol * damping


def test_poles_without_noise_are_exact_and_the_close_pair_is_two():
    data = responses(noise=1e-6)
    modes = fit_poles(data, stabilise(data, 20.0, 390.0, 40).candidates)
    # the polynomial for modes outside the band leaves about 1e-5 of a frequency
    np.testing.assert_allclose([m.frequency for m in modes], FREQUENCIES, rtol=1e-5)
    np.testing.assert_allclose([m.damping for m in modes], DAMPING, rtol=5e-3)
    s = eigenvalues(np.array([190.0, 200.0]), np.array([0.01, 0.01]))  # a louder neighbour shifts a peak
    frf = accelerance(LINES, s, np.array([[-3.0, 1.0]]) / (2j * s.imag))
    data = FrequencyResponses(LINES, frf, 0.0, "synthetic")
    _, weak = fit_poles(data, stabilise(data, 100.0, 300.0, 20).candidates)
    assert weak.frequency == pytest.approx(200.0, abs=1e-3)
    assert weak.peak == 198.5  # by most of its half width of 2 Hz


LONG = [pytest.mark.slow, pytest.mark.weekly]


@pytest.mark.parametrize(
    ("n_tests", "n_responses", "least", "inside"),
    [
        (6, 3, 0.9, 0.84),  # 40 poles: 0.95 minus three standard errors
        *(pytest.param(100, n, 0.95, p, marks=LONG) for n, p in ((3, 0.92), (1, 0.90))),  # one: pairs worse
    ],
)
def test_poles_lie_within_their_standard_deviations_in_95_of_100(n_tests, n_responses, least, inside):
    rng, errors, clear, spurious = np.random.default_rng(0), [], [], 0
    for _ in range(n_tests):
        known = known_test(rng, n_responses, 0.01)
        left = list(fit_poles(known.responses, stabilise(known.responses, 20.0, 790.0, 40).candidates))
        for f, damping, peak in zip(known.frequencies, known.damping, known.peak_over_noise, strict=True):
            near = [mode for mode in left if abs(mode.frequency - f) < damping * f]
            clear += [bool(near)] if peak > 10.0 else []
            if near:
                mode = min(near, key=lambda one: abs(one.frequency - f))
                left.remove(mode)
                errors.append((mode.frequency - f) / mode.sd)
        spurious += len(left)
    assert np.mean(clear) > least
    assert spurious <= max(1, n_tests // 20)
    assert np.mean(np.abs(errors) < 1.96) > inside


def written_universal(path, data, binary):
    common = {"func_type": 4, "rsp_dir": 3, "ref_node": 1, "ref_dir": 3, "binary": binary}
    common |= {"abscissa_spec_data_type": 18, "ordinate_spec_data_type": 12, "orddenom_spec_data_type": 13}
    common |= {"rsp_ent_name": "", "ref_ent_name": "", "abscissa_spacing": 1, "x": data.frequencies}
    named = [{"rsp_node": k, "data": frf, "id1": f"response {k}"} for k, frf in enumerate(data.frf, 1)]
    pyuff.UFF(str(path)).write_sets([pyuff.prepare_58(**common, **one) for one in named], "add")


@pytest.fixture(scope="module")
def tapped(tmp_path_factory):
    path = tmp_path_factory.mktemp("tap") / "tap.unv"
    written_universal(path, responses(), 0)
    return cb.poles(path, order=40)


# pyuff does not close a file to which it writes binary data
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_datasets_58_are_read(tapped, tmp_path):
    assert tapped.test.responses.origin == "dataset 58, 2 responses"
    assert_known(tapped.modes)
    written_universal(tmp_path / "tap.unv", responses(), 1)
    assert_known(cb.poles(tmp_path / "tap.unv", order=40).modes)


@pytest.mark.parametrize(
    ("heads", "n_responses", "in_cells"),
    [
        ("from an analyser\nFrequency [Hz];Re 1;Im 1;Re 2;Im 2", 2, lambda h: (h.real, h.imag)),
        ("hz,magnitude 1,phase 1 [deg],magnitude 2,phase 2 [deg]", 2, lambda h: (abs(h), np.angle(h, True))),
        ("Frequenz [Hz];Realteil;Imaginärteil", 1, lambda h: (h.real, h.imag)),
        ("Frequenz [Hz];Betrag [dB];Phase [°]", 1, lambda h: (20.0 * np.log10(abs(h)), np.angle(h, True))),
        ("Frequenz [Hz];Amplitude [m/s2/N];Phase [Grad]", 1, lambda h: (abs(h), np.angle(h, True))),
    ],
)
def test_tables_are_read_in_every_form_with_english_and_german_heads(tmp_path, heads, n_responses, in_cells):
    data = responses(n_responses=n_responses)
    columns = np.stack((LINES, *(column for frf in data.frf for column in in_cells(frf))), axis=1)
    text = "\n".join([heads, *(";".join(f"{value:.10g}" for value in row) for row in columns)])
    table = text.replace(".", ",") if ";" in heads else text.replace(";", ",")
    (tmp_path / "tap.csv").write_text(table, encoding="utf-8")
    found = cb.poles(tmp_path / "tap.csv", order=40, high_hz=390.0)
    assert_known(found.modes)
    np.testing.assert_allclose(found.test.responses.frf, data.frf, rtol=1e-7, atol=1e-9)


RATE, SECONDS = 4000, 2.0


def hits(n):
    """Force and response of successive hits, half sines of 2 ms on a plate with the known modes."""
    rng, t = np.random.default_rng(0), np.arange(int(RATE * SECONDS)) / RATE
    s = eigenvalues(FREQUENCIES, DAMPING)
    impulse = np.sum(np.array([1.0, 0.8, -0.9, 1.1, 0.7])[:, None] * np.exp(s[:, None] * t).imag, axis=0)
    records = []
    for _ in range(n):
        force = np.zeros_like(t)
        force[40:48] = rng.uniform(0.5, 1.0) * np.sin(np.pi * np.arange(8) / 8)
        records.append((force, np.convolve(force, impulse)[: len(t)]))
    both = np.concatenate(records, axis=1)
    both[0] += 1e-4 * rng.standard_normal(both.shape[1])
    both[1] += 1e-3 * np.abs(both[1]).max() * rng.standard_normal(both.shape[1])
    return np.asarray((30000.0 * both / np.abs(both).max(axis=1, keepdims=True)).astype(np.int16).T)


def wave(rate, samples):
    file = io.BytesIO()
    wavfile.write(file, rate, samples)
    return file.getvalue()


FREE = {"response": [2], "window": "none"}
# a half sine of 2 ms is above a tenth for 1.87 ms, of which the samples show 1.8
OVER_FORCE = "4 hits of 1.99 s, 1 response over force (channel 1, a pulse of 1.8 ms)"


@pytest.mark.parametrize(
    ("asked", "n_files", "origin", "rtol"),
    [
        (FREE | {"force": 1}, 1, OVER_FORCE, 1e-4),  # samples of decay and window are accurate to 1e-4
        (FREE | {"force": 1}, 4, OVER_FORCE, 1e-4),
        (FREE | {"force": 1, "window": "exponential"}, 1, OVER_FORCE, 1e-4),
        ({}, 1, OVER_FORCE, 1e-4),  # a pulse-shaped channel is the force
        (FREE, 1, "free decays", 2e-4),  # the missing force is smooth over a peak
    ],
)
def test_recorded_hits_give_the_poles_and_a_window_adds_no_damping(tmp_path, asked, n_files, origin, rtol):
    for i, part in enumerate(np.split(hits(4), n_files)):
        content = bytearray(wave(RATE, part))
        content[4:8] = b"\xff\xff\xff\x7f"  # the recorder never filled in the length
        (tmp_path / f"hit_{i}.wav").write_bytes(content)
    result = cb.poles(tmp_path, **asked, high_hz=390.0, order=40)
    assert origin in result.test.responses.origin
    assert len(result.test.responses.frf) == 4
    assert_known(result.modes, rtol=rtol)
    if asked == FREE | {"force": 1}:
        # a half sine of 2 ms has fallen to a tenth at 1.27 / 2 ms, below its first zero at 1.5 / 2 ms
        assert 550.0 < cb.poles(tmp_path, **asked, order=40).test.high < 750.0


@pytest.mark.parametrize(
    ("kind", "gain", "top"),
    [
        *((kind, gain, 32767) for kind in (np.int16, np.float32) for gain in (3.0, 30.0)),
        (np.int16, 1.0, 8000),  # an amplifier before the recorder
    ],
)
def test_a_record_clipped_at_its_top_is_refused(tmp_path, kind, gain, top):
    full = 32767.0 if kind is np.int16 else 1.0
    samples = np.clip(gain / 30000.0 * hits(2)[:, 1], -top / 32767, top / 32767) * full
    wavfile.write(tmp_path / "clip.wav", RATE, samples.astype(kind))
    with pytest.raises(ModalTestError, match=r"clip.wav: channel 1 is clipped: .* samples hold its largest"):
        cb.poles(tmp_path / "clip.wav", response=[1], window="none")


def test_a_record_of_a_few_samples_has_no_hit(tmp_path):
    wavfile.write(tmp_path / "short.wav", RATE, np.zeros((1, 2), np.int16))
    with pytest.raises(ModalTestError, match="no hit"):
        cb.poles(tmp_path / "short.wav", force=1, response=[2], window="exponential")


def test_decays_at_a_high_rate_are_searched_where_they_stand_above_noise(tmp_path):
    rate, rng = 44100, np.random.default_rng(0)
    t = np.arange(3 * rate) / rate
    decay = np.sum(np.exp(eigenvalues(FREQUENCIES, DAMPING)[:, None] * t).imag, axis=0)
    samples = decay / np.abs(decay).max() + 0.01 * rng.standard_normal(len(t))
    wavfile.write(tmp_path / "phone.wav", rate, (30000.0 / 1.1 * samples).astype(np.int16))
    result = cb.poles(tmp_path / "phone.wav", **HIT, order=40)
    assert FREQUENCIES[-1] < result.test.high < 2.0 * FREQUENCIES[-1]
    assert result.test.low < 0.5 * FREQUENCIES[0]
    assert_known(result.modes, rtol=2e-4)
    cut = cb.poles(tmp_path / "phone.wav", **HIT, order=20, low_hz=100.0, high_hz=200.0)
    assert "modes_beyond_range" in codes(cut)


def test_a_peak_without_a_mode_is_named_and_no_mode_is_no_success(run, tmp_path):
    tap, frf = tmp_path / "tap.csv", responses(n_responses=1).frf[0].copy()
    frf[np.flatnonzero(LINES == 250.0)] = 0.3 * np.abs(frf).max()  # a steady tone
    tap.write_bytes(rows(*(f"{f},{h.real},{h.imag}" for f, h in zip(LINES, frf, strict=True))))
    result = cb.poles(tap, order=40, high_hz=390.0)
    assert_known(result.modes)
    assert result.notices[0] == Notice("peaks_without_pole", facts={"peaks": (250.0,)})
    noise = np.random.default_rng(0).standard_normal((2, len(LINES)))
    tap.write_bytes(rows(*(f"{f},{a},{b}" for f, a, b in zip(LINES, *noise, strict=True))))
    status, out, err = run("poles", tap, "--order", "20", "--out", tmp_path / "out")
    assert status == 1
    assert "No modes found." in out
    assert "No mode found from" in err
    assert not (tmp_path / "out" / "modes.csv").exists()


def test_the_table_is_read_by_a_plate_file(tapped, tmp_path):
    out, file = tmp_path / "out", tmp_path / "bar.toml"
    tapped.save(out)
    shown = tapped.summary(verbose=True)
    assert "5 modes from 81" in shown
    assert 'table = "modes.csv"' in shown
    assert any("closer than a peak width: 147.3 and 149.6" in said for said in tapped.warnings)
    modes = json.loads((out / "poles.json").read_text("utf-8"))["modes"]
    hz, sd, damping, heights = ([m[key] for m in modes] for key in ("hz", "sd", "damping", "height"))
    assert all(np.diff(hz) > 0.0)
    file.write_text(f'{OF_TABLE}table = "out/modes.csv"\n', encoding="utf-8")
    measurement = cb.read_plate(file).measurement
    np.testing.assert_allclose(measurement.frequencies, hz, rtol=1e-5)
    np.testing.assert_allclose(measurement.frequency_sd, sd, rtol=1e-2)
    np.testing.assert_allclose(measurement.damping, damping, rtol=1e-3)
    file.write_text(f'{OF_TABLE}peaks = "out/modes.csv"\n', encoding="utf-8")
    probability = cb.read_plate(file).measurement.mode_probability
    np.testing.assert_allclose(probability, mode_probability(np.array(heights), np.ones(5)), rtol=0.02)


def rows(*values):
    return "\n".join(["hz,re,im", *values]).encode()


def listed(heads, row):
    return "\n".join([heads, *(f"{f},{row}" for f in range(1, 300))]).encode()


LIKE_DB = "magnitudes from 61 to 61 of no unit, as levels in dB are, accepted: magnitude [dB]"
HUGE, LEVELS = rows("0,0,0", "1,1e300,0"), listed("hz,magnitude,phase [deg]", "61,100")
STEADY = [f"{i},1,0" for i in range(100)]
HIT = {"response": [1], "window": "none"}
HITS = wave(RATE, hits(2))
MANY_HITS = wave(1, np.tile(np.array([1, 0, 0], np.int16), 2000))
LONG = wave(48_000, np.tile(np.array([255, 0], np.uint8), 4_100_000))


@pytest.mark.parametrize(
    ("name", "content", "options", "said"),
    [
        ("sub/hits", None, {}, "hits: no such file or folder, accepted"),
        ("none.unv", None, {}, "none.unv: no such file or folder, accepted: frequency responses"),
        ("", None, {}, "no recordings in this folder, accepted: .wav files"),
        (None, None, {}, "no file, accepted: one or more"),
        ("tap.wav", HITS, {"force": 2, "response": [1]}, "a channel that rings long after the hit"),
        ("tap.wav", HITS, {"force": 2, "response": [2]}, "received 2 for both"),
        ("tap.wav", HITS, {"force": 3, "response": [2]}, "no channel 3, accepted: 1 to 2"),
        ("tap.doc", b"", {}, "unknown ending, accepted: frequency responses"),
        ("tap.unv", b"hello", {}, "no frequency response functions, accepted: datasets 58 of type 4"),
        ("tap.csv", b"a,b\n1,2\n", {}, "no table of responses, accepted: a line of heads with hz"),
        ("tap.csv", b"hz,re,im\n1,2,x\n", {}, "tap.csv:2: not a row of 3 numbers"),
        ("tap.csv", b"hz,re,im\n1,2,3\n2,1,1\n9,1,1\n", {}, "lines that do not ascend by equal steps"),
        ("tap.csv", rows(*STEADY), {}, "accepted: 100 or more for --order 50"),
        ("tap.csv", b"hz,re,im\n1,2,3\n2,1,1\n", {"force": 1}, "accepted: with .wav files only"),
        ("tap.wav", b"RIFF", HIT, "not a .wav file that can be read"),
        ("tap.csv", b"hz,re,im\n1,2,3\n2,1,1\n", {"order": 5}, "--order: received 5, accepted: 10 to 200"),
        ("tap.csv", rows(*STEADY[:50], "50,nan,0", *STEADY[51:]), {}, "no number at 50 Hz, accepted: one at"),
        ("tap.csv", rows("0,0,0", "1,0,0", "2,0,0"), {}, "response 1 that is zero at all lines"),
        ("tap.csv", HUGE, {}, "response 1 whose largest value is 1e+300, accepted: 1e-60"),
        ("tap.csv", rows("0,1,0", "1e300,1,0"), {}, "lines of frequency up to 1e+300 Hz, accepted: 0.001 to"),
        ("tap.csv", rows() + b"\n" * 500_000, {}, "received 500000 lines, accepted: 200000 at most"),
        ("tap.unv", b"    -1\n" * 30_000, {}, "received 15000 datasets, accepted: 10000 at most"),
        ("tap.wav", wave(0, np.ones(9, np.int16)), HIT, "9 samples, 0 a second, accepted: above 0"),
        ("tap.wav", wave(8, np.full(99, np.nan)), HIT, "samples that are no numbers"),
        ("tap.wav", MANY_HITS, HIT, "2000 hits, accepted: 1000 at most"),
        pytest.param("tap.wav", LONG, HIT, "Hz, accepted: 2000000 values at most", marks=pytest.mark.slow),
        ("tap.csv", listed("hz,magnitude,phase [deg]", "-3,100"), {}, "magnitudes below 0, down to -3, "),
        ("tap.csv", listed("hz,magnitude,phase", "1,3.1"), {}, "phases up to 3.1 of no unit, accepted: phas"),
        ("tap.csv", LEVELS, {}, LIKE_DB),
    ],
)
def test_what_cannot_be_read_is_said(tmp_path, name, content, options, said):
    files = () if name is None else (tmp_path / name,)
    if content is not None:
        files[0].write_bytes(content)
    with pytest.raises(ModalTestError) as caught:
        cb.poles(*files, **options)
    assert said in str(caught.value)


PLATE, DAMPED = np.array([63.0, 118.0, 176.0, 244.0, 331.0, 452.0, 587.0]), np.full(7, 6e-3)


def of_hits(folder, records):
    for i, record in enumerate(records):
        wavfile.write(folder / f"hit_{i}.wav", RATE_OF_HITS, record)
    return cb.poles(folder, high_hz=700.0)


def recorded(seed, n_hits, *faults, above=ABOVE):
    return [*recorded_hits(np.random.default_rng(seed), PLATE, DAMPED, n_hits, *faults, above=above)]


def assert_found(result, rtol, further=0):
    found = np.array([mode.frequency for mode in result.modes])
    assert all(np.min(np.abs(found / f - 1.0)) < rtol for f in PLATE)
    assert len(found) <= len(PLATE) + further


def codes(result):
    return {notice.code for notice in result.notices}


def told(result, code, fact):
    return [notice.facts[fact] for notice in result.notices if notice.code == code]


def test_a_folder_of_hits_is_one_table_with_the_scatter_of_its_hits(tmp_path):
    result = of_hits(tmp_path, recorded(3, 6, Faults(drift=0.002)))
    assert_found(result, 0.003)
    assert {mode.hits for mode in result.modes} == {6}
    # 0.2 % over sqrt(6), times t / 1.96 with five degrees of freedom, and the chance of six values
    sd = np.array([mode.sd / mode.frequency for mode in result.modes])
    assert 0.4 < np.sqrt(np.mean(sd**2)) / (0.002 / np.sqrt(6.0) * 2.571 / 1.96) < 1.7
    drifting = tmp_path / "drifting"  # modes that drift by two per cent are single modes and are named
    drifting.mkdir()
    result = of_hits(drifting, recorded(6, 4, Faults(drift=0.008)))
    assert_found(result, 0.02)
    assert "drifting_modes" in codes(result)


@pytest.mark.slow
def test_no_standard_deviation_is_below_a_thirtieth_of_a_line_of_one_hit(tmp_path):
    faults = Faults(drift=0.0, noise=1e-4)
    one = of_hits(tmp_path, recorded(1, 1, faults))
    assert min(mode.sd for mode in one.modes) >= one.test.responses.step / 30.0 > 0.01
    many = of_hits(tmp_path, recorded(1, 9, faults))
    assert min(mode.sd for mode in many.modes) >= 0.01


def test_hum_is_no_mode_and_found_beside_a_second_stroke_and_a_mode_at_the_mains_is_no_hum(tmp_path):
    result = of_hits(tmp_path, recorded(4, 3, Faults(hum=0.05)))
    assert_found(result, 0.003)
    assert set(told(result, "hum", "mains")) == {50.0}
    assert not any(abs(mode.frequency - f) < 1.0 for mode in result.modes for f in (50.0, 150.0))
    (peaks,) = told(result, "peaks_without_pole", "peaks")
    assert all(is_of_mains(f, result.test.responses.step) for f in peaks)
    for stroke in (None, 0.045, 0.3):  # also with a second stroke; a mode is silent before its hit
        (record,) = recorded(5, 1, Faults(hum=0.1, second_stroke=stroke), above=())
        (notice,) = hum_notices(RATE_OF_HITS, record[None].astype(float))
        assert notice.facts["mains"] == 50.0
        assert notice.facts["size"] == pytest.approx(0.1 * np.sqrt(2.0), rel=0.25)  # 50 and 150 Hz, 0.1 each
    frequency, damping, rng = np.array([50.0]), np.array([1e-3]), np.random.default_rng(0)
    (decay,) = recorded_hits(rng, frequency, damping, 1, Faults(drift=0.0), above=())
    for sooner, found in ((0.0, True), (0.05, False)):
        record = np.append(np.zeros(int(sooner * RATE_OF_HITS)), decay.astype(float))
        assert bool(hum_notices(RATE_OF_HITS, record[None])) is found


@pytest.mark.parametrize("height", [0.4, 0.22])
def test_a_late_click_is_no_hit_and_shortens_none(tmp_path, height):
    records = recorded(5, 3)
    at, lasts = int(1.42 * RATE_OF_HITS), RATE_OF_HITS // 1000
    click = height * np.abs(records[1]).max() * np.array([1.0, -1.0] * (lasts // 2))
    records[1][at : at + lasts] += click.astype(np.int16)
    result = of_hits(tmp_path, records)
    assert result.test.responses.step == pytest.approx(1.0 / 1.41, rel=0.01)
    assert [len(each.frf) for each in result.test.responses.each_hit] == [1, 1, 1]
    assert "double_hits" not in codes(result)
    left = ("hit_1.wav", pytest.approx(1.42, abs=0.005), pytest.approx(0.08, abs=0.005))
    assert told(result, "short_hits", "short") == [(left,)]
    assert_found(result, 0.003)


def test_a_force_through_an_ac_coupling_has_its_lines(tmp_path):
    decay = recorded(5, 1)[0].astype(float)
    t = np.arange(len(decay)) / RATE_OF_HITS
    pulse = np.exp(-0.5 * ((t - 0.01) / 2e-4) ** 2)
    # a first-order high pass at 1 Hz: the part below is subtracted from the pulse
    below = 2.0 * np.pi / RATE_OF_HITS * np.convolve(pulse, np.exp(-2.0 * np.pi * t))[: len(t)]
    channels = np.stack((2e4 * (pulse - below), decay), axis=1).astype(np.int16)
    wavfile.write(tmp_path / "coupled.wav", RATE_OF_HITS, channels)
    assert cb.poles(tmp_path / "coupled.wav", force=1).test.responses.frequencies[-1] > PLATE[-1]


def test_a_response_that_is_one_tone_beyond_the_range_is_a_sensor_that_rings(tmp_path):
    hit = recorded(9, 1)[0].astype(float)
    t = np.arange(len(hit)) / RATE_OF_HITS
    ringing = hit + 1e5 * np.exp(-40.0 * t) * np.sin(2.0 * np.pi * 2900.0 * t)
    for record, channels in ((hit, []), (ringing, [1])):
        result = of_hits(tmp_path, [(record / 4.0).astype(np.int16)])
        assert told(result, "ringing_sensor", "channel") == channels


@pytest.mark.parametrize(("others", "apart"), [(1, (5,)), (4, (1, 2, 3, 4, 5, 6, 7, 8))])
def test_hits_that_share_few_modes_are_named(tmp_path, others, apart):
    rng = np.random.default_rng(8)
    records = recorded_hits(rng, PLATE, DAMPED, 4) + recorded_hits(rng, 1.13 * PLATE, DAMPED, others)
    assert told(of_hits(tmp_path, records), "hits_apart", "hits") == [apart]


def test_a_clipped_file_is_left_out_and_a_hit_on_another_plate_counts(tmp_path):
    rng = np.random.default_rng(7)
    records = recorded_hits(rng, PLATE, DAMPED, 4) + recorded_hits(rng, 0.99 * PLATE, DAMPED, 1)
    clipped = np.clip(3 * records[0].astype(int), -32768, 32767).astype(np.int16)
    result = of_hits(tmp_path, [*records, clipped])
    assert told(result, "clipped_files", "files") == [("hit_5.wav",)]
    assert len(result.modes[0].each) == 5


def test_channels_are_force_or_response_and_those_without_a_signal_are_named(tmp_path):
    rng = np.random.default_rng(8)
    one, other = recorded_hits(rng, PLATE, DAMPED, 2)
    noise = (40.0 * rng.standard_normal(len(one))).astype(np.int16)
    silence, force = np.zeros_like(one), np.zeros_like(one)
    force[80:84] = (8000, 16000, 16000, 8000)
    for channels, said, silent in (
        ((one, other), "2 responses alone: free decays (channels 1, 2)", []),
        ((one, silence), "1 response alone: free decays (channel 1)", [(2,)]),
        ((one, noise), "1 response alone: free decays (channel 1)", [(2,)]),
        ((silence, force, one), "1 response over force (channel 2", [(1,)]),
    ):
        result = of_hits(tmp_path, [np.stack(channels, axis=1)])
        assert said in result.test.responses.origin
        assert told(result, "silent_channels", "channels") == silent
        assert_found(result, 0.003)


def test_a_file_that_is_given_twice_or_was_copied_counts_once(tmp_path):
    once = of_hits(tmp_path, recorded(8, 2))
    (tmp_path / "hit_2.wav").write_bytes((tmp_path / "hit_0.wav").read_bytes())
    twice = cb.poles(tmp_path, tmp_path / "hit_1.wav", high_hz=700.0)
    assert told(twice, "repeated_files", "files") == [("hit_2.wav", "hit_1.wav")]
    assert twice.modes == once.modes


def test_an_offset_is_no_stroke_and_hits_that_follow_each_other_closely_are_hits(tmp_path):
    (record,) = recorded(3, 1, Faults(noise=0.01), above=())
    centred, offset = (of_hits(tmp_path, [(record // 2 + added).astype(np.int16)]) for added in (0, 15000))
    assert "double_hits" not in codes(offset)
    f, expected = ([mode.frequency for mode in result.modes] for result in (offset, centred))
    np.testing.assert_allclose(f, expected, rtol=1e-4)
    apart, n_hits = int(0.3 * RATE_OF_HITS), 6
    decays = recorded(6, n_hits, Faults(noise=0.002), above=())
    record = np.zeros(n_hits * apart + 80)
    for k, decay in enumerate(decays):
        ringing = decay[: len(record) - k * apart]
        record[k * apart : k * apart + len(ringing)] += 0.5 * ringing
    result = of_hits(tmp_path, [record.astype(np.int16)])
    assert len(result.test.responses.each_hit) == n_hits
    assert not codes(result) & {"double_hits", "short_hits"}


@pytest.mark.parametrize(
    ("faults", "n_hits", "above", "found"),
    [
        ({}, 3, ABOVE, {}),
        ({"second_stroke": 0.045}, 3, ABOVE, {"double_hits": {"hits": (1, 2, 3), "of": 3}}),
        ({"second_stroke": 0.045, "twice": 1 / 3}, 3, ABOVE, {"double_hits": {"hits": (1,), "of": 3}}),
        # late, on a plate without loud high modes
        ({"second_stroke": 0.15, "noise": 0.005}, 1, (), {"double_hits": {"hits": (1,), "of": 1}}),
        ({"second_stroke": 0.2, "noise": 0.005}, 1, (), {"double_hits": {"hits": (1,), "of": 1}}),
        ({"second_stroke": 0.3, "noise": 0.005}, 1, (), {"short_hits": None}),
    ],
)
def test_a_second_stroke_is_numbered_and_followed_by_the_free_decay(tmp_path, faults, n_hits, above, found):
    result = of_hits(tmp_path, recorded(5, n_hits, Faults(**faults), above=above))
    assert_found(result, 0.003)
    assert codes(result) & {"double_hits", "short_hits"} == set(found)
    assert "hum" not in codes(result)  # the mode at 63 Hz still rings at the end after a late stroke
    said = {notice.code: notice.facts for notice in result.notices}
    assert all(facts is None or said[code] == facts for code, facts in found.items())


def test_what_shows_in_double_hits_alone_is_of_the_second_hit():
    mode, ripple = (Pole(f, 0.1, 0.01, 1e-3) for f in (100.0, 150.0))
    weak = Pole(200.0, 0.1, 0.01, 1e-3, 0.1)
    each = ((mode, ripple, weak), (mode, weak), (mode, weak))
    taken = [pole.taken for pole in modes_of_hits(each, 0.5, (True, False, False))]
    assert taken == [Taken.MODE, Taken.SECOND_HIT, Taken.WEAK]
    # if all hits have a second stroke, none reveals the ripples
    assert Taken.SECOND_HIT not in {pole.taken for pole in modes_of_hits(each, 0.5, (True, True, True))}


def test_noise_of_the_force_is_a_part_of_the_standard_deviations(tmp_path):
    errors = []
    for seed in range(6):
        rng, faults = np.random.default_rng([36, seed]), Faults(noise=0.005, drift=0.0)
        decay = recorded_hits(rng, PLATE, DAMPED, 1, faults, above=())[0]
        force = 60.0 * rng.standard_normal(len(decay))
        force[80:84] += (10000.0, 20000.0, 20000.0, 10000.0)
        wavfile.write(tmp_path / "hit.wav", RATE_OF_HITS, np.stack((force.astype(np.int16), decay), axis=1))
        for mode in cb.poles(tmp_path / "hit.wav", high_hz=700.0).modes:
            known = int(np.argmin(np.abs(PLATE - mode.frequency)))
            errors.append(abs(mode.damping - DAMPED[known]) / mode.damping_sd)
    assert len(errors) > 36
    assert np.mean(np.array(errors) < 1.96) > 0.84  # 0.95 minus three standard errors of 40
