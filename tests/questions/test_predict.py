"""Frequencies predicted from a stored posterior: closed forms, the truth, sizes of the plate, bad files."""

import json
import lzma
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import cpam_bayes as cb
from cpam_bayes.questions.identify import SampledResult
from tests.plate_file import described, refused
from tests.posteriors import write_posterior

DATA = Path(__file__).parents[1] / "data"

E_REFERENCE = 69.0
ALUMINIUM = {"isotropic": True, "E1_GPa": E_REFERENCE, "nu12": 0.33}
SIMULATED = described((300.0, 280.0, 3.0), 2700.0, ALUMINIUM, specimen="simulated")
UNKNOWN = {"unknowns": {"E1_GPa": [30.0, 120.0], "nu12": [0.15, 0.45]}}


EXACT = dict.fromkeys(("length_mm", "width_mm", "thickness_mm", "density_kg_m3"), 0.0)


def cantilever(sd: dict[str, float] = EXACT, **sizes: Any) -> dict[str, Any]:
    """Another plate of the same material, clamped on one edge, of exact sizes where nothing is said."""
    changed = {"length_mm": 200.0, "width_mm": 100.0, "edges": "CFFF", **sizes, "sd": sd}
    named = {"name": "cantilever", "specimen": "cantilever"}
    return {**SIMULATED, **named, "plate": {**SIMULATED["plate"], **changed}}


@pytest.fixture
def modulus_only(tmp_path: Path) -> tuple[Path, np.ndarray]:
    """Draws of E1 with everything else held, and the draws."""
    e = E_REFERENCE * (1.0 + 0.05 * np.random.default_rng(1).standard_normal(800))
    return write_posterior(tmp_path / "posterior.nc", {"E1_GPa": e, "relative_std": np.full(800, 0.01)}), e


def test_frequencies_go_with_the_root_of_the_modulus_and_noise_widens_those_that_are_measured(
    modulus_only,
) -> None:
    path, e = modulus_only
    at_reference = cb.forward(cantilever(), 4).frequencies
    result = cb.predict(path, cantilever(), 4)
    expected = np.sqrt(e / E_REFERENCE)
    for mode, f in zip(result.modes, at_reference, strict=True):
        # the models are converged to 0.02 %, and a quantile of 800 draws is the same monotone map of theirs
        assert mode.mean == pytest.approx(f * expected.mean(), rel=3e-4)
        assert mode.sd == pytest.approx(f * expected.std(ddof=1), rel=5e-3)
        assert mode.q025 == pytest.approx(f * np.quantile(expected, 0.025), rel=3e-4)
        assert mode.q975 == pytest.approx(f * np.quantile(expected, 0.975), rel=3e-4)
    spread = np.hypot((0.5 * e.std(ddof=1) / E_REFERENCE), 0.01)
    # quantiles of 800 draws are good to some 6 % of their distance
    first = result.modes[0]
    assert first.measured_q025 < first.q025 < first.q975 < first.measured_q975
    assert first.measured_q975 / first.measured_q025 - 1.0 == pytest.approx(2 * 1.96 * spread, rel=0.15)


@pytest.mark.parametrize(
    ("sd", "of_sizes"),
    [
        ({**EXACT, "thickness_mm": 0.03}, (0.03,)),
        # the usual one, and a density of 1 % and a length of 0.1 %, the first mode going with 1 / L^2
        ({}, (0.01, 0.005, 0.002)),
    ],
)
def test_a_thickness_widens_a_thin_plate_in_proportion(modulus_only, sd, of_sizes) -> None:
    path, e = modulus_only
    (mode,) = cb.predict(path, cantilever(sd, thickness_mm=1.0), 1).modes
    expected = np.linalg.norm((0.5 * e.std(ddof=1) / E_REFERENCE, *of_sizes))
    assert mode.sd / mode.mean == pytest.approx(expected, rel=0.1)  # 800 draws know a spread to 2.5 %


@pytest.mark.parametrize(
    ("sd", "said"),
    [
        (EXACT, "contain the constants; sizes and mass are exact."),
        ({}, "contain the constants, thickness, length, width and density."),
        ({**EXACT, "thickness_mm": 0.03}, "contain the constants and thickness."),
    ],
)
def test_intervals_are_said_to_contain_the_sizes_that_vary_in_them(modulus_only, sd, said: str) -> None:
    path, _ = modulus_only
    lines = " ".join(cb.predict(path, cantilever(sd), 1).report().summary.lines)
    assert said in lines


@pytest.fixture(scope="module")
def sampled() -> SampledResult:
    """The posterior of a plate with a list that its model computes exactly, its thickness not known well."""
    f = cb.forward(SIMULATED, 6).frequencies
    measured = {"frequencies_hz": f.tolist(), "relative_std": 0.003}
    uncertain = {**SIMULATED["plate"], "sd": {"thickness_mm": 0.06}}
    return cb.sample({**SIMULATED, **UNKNOWN, "plate": uncertain, "measurement": measured}, seed=0)


@pytest.mark.slow
def test_another_test_of_the_same_plate_has_the_sizes_of_the_draws(sampled: SampledResult) -> None:
    """Thickness and modulus are known badly, what they do together well: the frequencies show that."""
    clamped = {**SIMULATED, "name": "clamped", "plate": {**SIMULATED["plate"], "edges": "CFFF"}}
    own = cb.predict(sampled, clamped, 3)
    other = cb.predict(sampled, {**clamped, "specimen": "sister"}, 3)
    assert own.sizes_of_posterior
    for narrow, wide in zip(own.modes, other.modes, strict=True):
        assert narrow.sd < 0.3 * wide.sd
        assert wide.sd / wide.mean == pytest.approx(0.02, rel=0.2)  # of a thickness that is known to 2 %


def test_another_plate_has_the_sizes_of_its_file_and_its_truth_lies_in_the_intervals(
    sampled: SampledResult,
) -> None:
    result = cb.predict(sampled, cantilever(), 5)
    assert not result.sizes_of_posterior
    for mode, f in zip(result.modes, cb.forward(cantilever(), 5).frequencies, strict=True):
        assert mode.q025 < f < mode.q975
    # so has one of the same name and another size, which is told
    thinner = {**SIMULATED, "plate": {**SIMULATED["plate"], "thickness_mm": 1.0, "length_mm": 150.0}}
    result = cb.predict(sampled, thinner, 3)
    assert not result.sizes_of_posterior
    told = {name: here for name, here, _ in result.notices[0].facts["sizes"]}
    assert told == {"length": 0.15, "thickness": 0.001}
    named = cb.predict(sampled, {**thinner, "specimen": "sister"}, 3)
    assert [m.mean for m in result.modes] == [m.mean for m in named.modes]
    assert named.notices == result.notices[1:]


def test_a_saved_posterior_predicts_its_own_list_as_the_result_does(
    sampled: SampledResult, tmp_path: Path
) -> None:
    sampled.to_arviz().to_netcdf(str(tmp_path / "posterior.nc"))
    plate = {**SIMULATED, "plate": {**SIMULATED["plate"], "sd": {"thickness_mm": 0.06}}}
    from_file = cb.predict(tmp_path / "posterior.nc", plate, 6)
    at_once = cb.predict(sampled, plate, 6)
    assert from_file.posterior.repeatability == 0.003
    np.testing.assert_array_equal(from_file.frequencies, at_once.frequencies)
    mean = [mode.mean for mode in from_file.modes]
    np.testing.assert_allclose(mean, sampled.predicted[:6], rtol=5e-4)
    sd = [mode.sd for mode in from_file.modes]
    np.testing.assert_allclose(sd, sampled.predicted_sd[:6], rtol=0.15)  # other draws of one posterior


def test_a_posterior_of_0_1_0_still_opens(tmp_path: Path) -> None:
    """Written by `cb.sample("A1", seed=0)` of version 0.1.0, two ensembles of 8 walkers, 6 steps each."""
    path = tmp_path / "posterior.nc"
    path.write_bytes(lzma.decompress((DATA / "posterior_0.1.0.nc.xz").read_bytes()))
    found = cb.predict(path, "A2")
    # its E1 is 67.96 GPa on average, that of the file of A2 69 GPa
    reference = cb.forward("A2", len(found.modes)).frequencies
    means = [mode.mean for mode in found.modes]
    np.testing.assert_allclose(means, np.sqrt(67.96 / 69.0) * reference, rtol=0.01)


def test_a_constant_that_was_held_at_another_value_is_told(tmp_path: Path) -> None:
    path = write_posterior(
        tmp_path / "posterior.nc",
        {"E1_GPa": np.linspace(68.0, 70.0, 50)},
        held_constants=json.dumps({"nu12": 0.3}),
        symmetry="isotropic",
    )
    (notice,) = cb.predict(path, cantilever(), 1).notices
    assert notice.facts["constants"] == (("nu12", 0.3, 0.33),)


def test_a_plate_whose_thickness_mass_and_density_disagree_is_told(tmp_path: Path) -> None:
    path = write_posterior(
        tmp_path / "posterior.nc", {"E1_GPa": np.linspace(68.0, 70.0, 50)}, symmetry="isotropic"
    )
    codes = [n.code for n in cb.predict(path, cantilever({}, mass_g=500.0), 1).notices]
    assert codes[0] == "thicknesses_apart"


def test_what_is_no_posterior_of_this_material_is_refused_with_what_is_accepted(
    run: Any, tmp_path: Path
) -> None:
    text = tmp_path / "text.nc"
    text.write_text("no NetCDF", encoding="utf-8")
    angles = write_posterior(tmp_path / "angles.nc", {"angle_1": np.zeros(9)})
    nothing = write_posterior(tmp_path / "nan.nc", {"E1_GPa": np.full(9, np.nan)})
    e1, e2 = np.linspace(120.0, 125.0, 9), np.linspace(9.0, 9.4, 9)
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
    run: Any, tmp_path: Path
) -> None:
    path = write_posterior(tmp_path / "posterior.nc", {"E1_GPa": np.linspace(66.0, 69.0, 50)})
    status, out, _ = run("predict", path, "A1", "--modes", "3", "--json", "--quiet")
    document = json.loads(out)
    assert status == 0
    assert [f["measured_hz"] for f in document["frequencies"]] == [114.0, 167.0, 218.0]
    result = cb.predict(path, "A1", 3)
    assert {**result.to_dict(), "seconds": 0} == {**document, "seconds": 0}
    shown = result.report()
    (rows, _) = shown.rows
    outside = [not r.m.measured_q025 <= r.measured.hz <= r.m.measured_q975 for r in rows.rows]
    assert f"{3 - sum(outside)} of 3 measured" in shown.summary.headline
    assert shown.summary.tables[0].flagged == {i for i, out in enumerate(outside) if out}
