"""Frequencies predicted from a stored posterior: closed forms, the truth, sizes of the plate, bad files."""

import json
import lzma
from pathlib import Path

import numpy as np
import pytest

import cpam_bayes as cb
from tests.plate_file import described, refused
from tests.posteriors import write_posterior

E_REFERENCE = 69.0
ALUMINIUM = {"isotropic": True, "E1_GPa": E_REFERENCE, "nu12": 0.33}
SIMULATED = described((300.0, 280.0, 3.0), 2700.0, ALUMINIUM, specimen="simulated")
EXACT = dict.fromkeys(("length_mm", "width_mm", "thickness_mm", "density_kg_m3"), 0.0)


def cantilever(sd=EXACT, **sizes):
    changed = {"length_mm": 200.0, "width_mm": 100.0, "edges": "CFFF", **sizes, "sd": sd}
    named = {"name": "cantilever", "specimen": "cantilever"}
    return {**SIMULATED, **named, "plate": {**SIMULATED["plate"], **changed}}


@pytest.fixture
def modulus_only(tmp_path):
    e = E_REFERENCE * (1.0 + 0.05 * np.random.default_rng(1).standard_normal(800))
    return write_posterior(tmp_path / "posterior.nc", {"E1_GPa": e, "relative_std": np.full(800, 0.01)}), e


def test_frequencies_go_with_the_root_of_the_modulus_and_noise_widens_those_that_are_measured(modulus_only):
    path, e = modulus_only
    at_reference = cb.forward(cantilever(), 4).frequencies
    result, expected = cb.predict(path, cantilever(), 4), np.sqrt(e / E_REFERENCE)
    quantiles = np.quantile(expected, (0.025, 0.975))
    for mode, f in zip(result.modes, at_reference, strict=True):
        # the models are converged to 0.02 %, and quantiles of 800 draws map to theirs monotonically
        assert mode.mean == pytest.approx(f * expected.mean(), rel=3e-4)
        assert mode.sd == pytest.approx(f * expected.std(ddof=1), rel=5e-3)
        assert (mode.q025, mode.q975) == pytest.approx(tuple(f * quantiles), rel=3e-4)
    spread = np.hypot((0.5 * e.std(ddof=1) / E_REFERENCE), 0.01)
    first = result.modes[0]  # quantiles of 800 draws are accurate to about 6 % of their distance
    assert first.measured_q025 < first.q025 < first.q975 < first.measured_q975
    assert first.measured_q975 / first.measured_q025 - 1.0 == pytest.approx(2 * 1.96 * spread, rel=0.15)


@pytest.mark.parametrize(
    ("sd", "of_sizes", "said"),
    [
        (EXACT, (), "contain the constants; sizes and mass are exact."),
        # the usual one, with density to 1 % and length to 0.1 %, the first mode scaling with 1 / L^2
        ({}, (0.01, 0.005, 0.002), "contain the constants, thickness, length, width and density."),
        ({**EXACT, "thickness_mm": 0.03}, (0.03,), "contain the constants and thickness."),
    ],
)
def test_sizes_widen_a_thin_plate_in_proportion_and_are_said_to(modulus_only, sd, of_sizes, said):
    path, e = modulus_only
    result = cb.predict(path, cantilever(sd, thickness_mm=1.0), 1)
    (mode,) = result.modes
    expected = np.linalg.norm((0.5 * e.std(ddof=1) / E_REFERENCE, *of_sizes))
    assert mode.sd / mode.mean == pytest.approx(expected, rel=0.1)  # 800 draws give a spread to 2.5 %
    assert said in " ".join(result.report().summary.lines)


@pytest.fixture(scope="module")
def sampled():
    """Posterior of a plate with its model's exact list and an uncertain thickness."""
    f = cb.forward(SIMULATED, 6).frequencies
    measured = {"frequencies_hz": f.tolist(), "relative_std": 0.003}
    uncertain = {**SIMULATED["plate"], "sd": {"thickness_mm": 0.06}}
    bounds = {"E1_GPa": [30.0, 120.0], "nu12": [0.15, 0.45]}
    plate = {**SIMULATED, "unknowns": bounds, "plate": uncertain, "measurement": measured}
    return cb.sample(plate, seed=0)


@pytest.mark.slow
def test_another_test_of_the_same_plate_has_the_sizes_of_the_draws(sampled):
    """Thickness and modulus are poorly known, but the frequencies determine their combination."""
    clamped = {**SIMULATED, "name": "clamped", "plate": {**SIMULATED["plate"], "edges": "CFFF"}}
    own, other = (cb.predict(sampled, {**clamped, **of}, 3) for of in ({}, {"specimen": "sister"}))
    assert own.sizes_of_posterior
    for narrow, wide in zip(own.modes, other.modes, strict=True):
        assert narrow.sd < 0.3 * wide.sd
        assert wide.sd / wide.mean == pytest.approx(0.02, rel=0.2)  # from a thickness known to 2 %


def test_another_plate_has_the_sizes_of_its_file_and_its_truth_lies_in_the_intervals(sampled):
    result = cb.predict(sampled, cantilever(), 5)
    assert not result.sizes_of_posterior
    for mode, f in zip(result.modes, cb.forward(cantilever(), 5).frequencies, strict=True):
        assert mode.q025 < f < mode.q975
    # so does one with the same name and another size, which is reported
    thinner = {**SIMULATED, "plate": {**SIMULATED["plate"], "thickness_mm": 1.0, "length_mm": 150.0}}
    result = cb.predict(sampled, thinner, 3)
    assert not result.sizes_of_posterior
    told = {name: here for name, here, _ in result.notices[0].facts["sizes"]}
    assert told == {"length": 0.15, "thickness": 0.001}
    named = cb.predict(sampled, {**thinner, "specimen": "sister"}, 3)
    assert [m.mean for m in result.modes] == [m.mean for m in named.modes]
    assert named.notices == result.notices[1:]


def test_a_saved_posterior_predicts_its_own_list_as_the_result_does(sampled, tmp_path):
    sampled.to_arviz().to_netcdf(str(tmp_path / "posterior.nc"))
    plate = {**SIMULATED, "plate": {**SIMULATED["plate"], "sd": {"thickness_mm": 0.06}}}
    from_file, at_once = (cb.predict(of, plate, 6) for of in (tmp_path / "posterior.nc", sampled))
    assert from_file.posterior.repeatability == 0.003
    np.testing.assert_array_equal(from_file.frequencies, at_once.frequencies)
    mean, sd = np.array([(mode.mean, mode.sd) for mode in from_file.modes]).T
    np.testing.assert_allclose(mean, sampled.predicted[:6], rtol=5e-4)
    np.testing.assert_allclose(sd, sampled.predicted_sd[:6], rtol=0.15)  # other draws of one posterior


def test_a_posterior_of_0_1_0_still_opens(tmp_path):
    """Written by `cb.sample("A1", seed=0)` of version 0.1.0, two ensembles of 8 walkers, 6 steps each."""
    path = tmp_path / "posterior.nc"
    stored = Path(__file__).parents[1] / "data" / "posterior_0.1.0.nc.xz"
    path.write_bytes(lzma.decompress(stored.read_bytes()))
    found = cb.predict(path, "A2")
    reference = cb.forward("A2", len(found.modes)).frequencies  # mean E1 67.96 GPa, in the file of A2 69 GPa
    means = [mode.mean for mode in found.modes]
    np.testing.assert_allclose(means, np.sqrt(67.96 / 69.0) * reference, rtol=0.01)


def test_a_constant_held_at_another_value_and_a_plate_that_contradicts_itself_are_told(tmp_path):
    e1, held = {"E1_GPa": np.linspace(68.0, 70.0, 50)}, json.dumps({"nu12": 0.3})
    path = write_posterior(tmp_path / "posterior.nc", e1, held_constants=held, symmetry="isotropic")
    (notice,) = cb.predict(path, cantilever(), 1).notices
    assert notice.facts["constants"] == (("nu12", 0.3, 0.33),)
    codes = [n.code for n in cb.predict(path, cantilever({}, mass_g=500.0), 1).notices]
    assert codes[0] == "thicknesses_apart"


def test_what_is_no_posterior_of_this_material_is_refused_with_what_is_accepted(run, tmp_path):
    text = tmp_path / "text.nc"
    text.write_text("no NetCDF", encoding="utf-8")
    e1, e2 = np.linspace(120.0, 125.0, 9), np.linspace(9.0, 9.4, 9)
    angles = write_posterior(tmp_path / "angles.nc", {"angle_1": np.zeros(9)})
    nothing = write_posterior(tmp_path / "nan.nc", {"E1_GPa": np.full(9, np.nan)})
    carbon = write_posterior(tmp_path / "carbon.nc", {"E1_GPa": e1, "E2_GPa": e2})
    named = write_posterior(tmp_path / "named.nc", {"E1_GPa": e1}, symmetry="isotropic")
    for path, plate, said in (
        (tmp_path, "A1", f"{tmp_path}: a directory, accepted: the posterior.nc"),
        (tmp_path / "none.nc", "A1", "none.nc: no file there, accepted: the posterior.nc"),
        (text, "A1", f"{text}: cannot be read as NetCDF"),
        (angles, "A1", "no draws of elastic constants"),
        (nothing, "A1", "draws of E1 are too few or not finite"),
        (carbon, "A1", "the material is isotropic, that of"),
        (named, "C1", "the material is transversely_isotropic"),
        ("A1", named, f"received the posterior {named}, accepted: the posterior first, then the"),
        ("panel.toml", "A1", "received the plate panel.toml, accepted: the posterior first, then the"),
    ):
        refused(run("predict", path, plate), said)


def test_the_command_gives_the_document_of_the_library_and_compares_with_the_measured_frequencies(
    run, tmp_path
):
    path = write_posterior(tmp_path / "posterior.nc", {"E1_GPa": np.linspace(66.0, 69.0, 50)})
    status, out, _ = run("predict", path, "A1", "--modes", "3", "--json", "--quiet")
    document, result = json.loads(out), cb.predict(path, "A1", 3)
    assert (status, {**document, "seconds": 0}) == (0, {**result.to_dict(), "seconds": 0})
    assert [f["measured_hz"] for f in document["frequencies"]] == [114.0, 167.0, 218.0]
    shown = result.report()
    (rows, _) = shown.rows
    outside = [not r.m.measured_q025 <= r.measured.hz <= r.m.measured_q975 for r in rows.rows]
    assert f"{3 - sum(outside)} of 3 measured" in shown.summary.headline
    assert shown.summary.tables[0].flagged == {i for i, out in enumerate(outside) if out}
