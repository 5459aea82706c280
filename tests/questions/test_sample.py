"""A sampled posterior as screen, document, figures and NetCDF."""

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cpam_bayes.answer import Notice
from cpam_bayes.inference.assessment import thinned
from cpam_bayes.inference.completeness import profile_likelihoods
from cpam_bayes.inference.ensemble import EnsembleSettings
from cpam_bayes.inference.sampling import basis_notices
from cpam_bayes.parameters import Parameter, ParameterSet, TruncatedNormal, Uniform
from cpam_bayes.plate import builtin
from cpam_bayes.questions.forward import forward
from cpam_bayes.questions.identify import SampledResult, sample
from cpam_bayes.questions.identify.posterior import product_text
from cpam_bayes.render.report import json_text
from tests.batches.plates import N_MODES, plate, written

SIZES = ("length_mm", "width_mm", "thickness_mm", "density_kg_m3")
SETTINGS = EnsembleSettings(walkers=16, round_steps=300, effective=100.0, most_steps=600)


@pytest.fixture(scope="module")
def sampled() -> SampledResult:
    """A1 with a normal prior of Poisson's ratio; its noise is inferred."""
    specimen = builtin("A1")
    own = specimen.unknowns.parameters
    informed = Parameter("nu12", "", TruncatedNormal(0.33, 0.01, 0.15, 0.4))
    unknowns = ParameterSet(tuple(informed if p.name == "nu12" else p for p in own))
    return sample(replace(specimen, unknowns=unknowns), seed=0, settings=SETTINGS)


@pytest.fixture(scope="module")
def gappy() -> SampledResult:
    """A1 without its third frequency."""
    specimen = builtin("A1")
    assert specimen.measurement is not None
    f = np.delete(specimen.measurement.frequencies, 2)
    own = replace(specimen.measurement, frequencies=f, labels=("",) * 5, complete=False, relative_std=0.01)
    return sample(replace(specimen, measurement=own), seed=0, settings=SETTINGS)


def screen(result: SampledResult) -> str:
    return result.summary(verbose=True)


def test_the_document_is_json_with_what_is_promised(sampled: SampledResult) -> None:
    document = json.loads(json_text(sampled.to_dict()))
    assert 0.99 < document["evidence"]["exact_fraction"] <= 1.0 + 1e-9
    drawn = {drawing.name for drawing in sampled.drawings()}
    assert drawn == {"posterior", "marginals_and_profiles", "left_out", "modes", "plate"}
    e1 = sampled.constants["E1"]
    assert (e1.value, *e1.interval) == pytest.approx(
        [1e9 * document["constants"]["E1_GPa"][key] for key in ("mean", "q025", "q975")], rel=1e-12
    )
    assert document["constants"]["nu12"]["prior"]["kind"] == "truncated normal"
    assert document["constants"]["nu12"]["prior"]["sd"] == pytest.approx(0.01, rel=0.01)
    assert "0.33 +- 0.01 in 0.15 to 0.4" in screen(sampled)
    d = document["diagnostics"]
    assert d["ess_per_second"] == pytest.approx(d["ess_bulk"] / d["seconds_sampling"], rel=1e-12)
    assert d["ess_per_second_in_all"] < d["ess_per_second"]
    assert set(document["identifiability"]["profiles"]) == {"E1_GPa", "nu12"}
    assert set(document["nuisance"]) == {*SIZES, "frequency_scale"}
    assert len(document["identifiability"]["combinations"]) == 2 + len(document["nuisance"])
    assert len(document["frequencies"]) == 6
    for row in document["frequencies"]:
        assert 0.0 < row["left_out"]["leverage"] < 1.0
        # a mode left out is predicted no better than one that is not, on the same side
        assert row["left_out"]["residual_percent"] / row["residual_percent"] > 1.0


def test_profiles_are_those_on_the_whole_basis(sampled: SampledResult) -> None:
    """That of Poisson's ratio spans its search interval, far beyond the draws of a narrow basis."""
    x, log_prob = sampled.result.draws, sampled.result.log_prob.ravel()
    again = profile_likelihoods(sampled.posterior, ("E1", "nu12"), x, log_prob)
    for found, expected in zip(sampled.assessment.profiles, again, strict=True):
        np.testing.assert_array_equal(found.drop, expected.drop)


def test_a_narrow_basis_that_moves_the_chains_is_said(sampled: SampledResult) -> None:
    evidence = replace(sampled.evidence, exact_fraction=0.6)
    assert basis_notices(evidence) == (Notice("narrow_basis", facts={"fraction": 0.6}),)
    assert basis_notices(sampled.evidence) == ()


def test_peaks_that_are_no_mode_are_not_counted_as_determining(sampled: SampledResult) -> None:
    mode = sampled.pairing.mode.copy()
    mode[2] = -1
    result = replace(sampled, pairing=replace(sampled.pairing, mode=mode))
    assert "The 6 frequencies determine" in sampled.report().summary.headline
    assert "The 5 frequencies determine" in result.report().summary.headline


def test_importance_sampling_is_quoted_where_it_is_reliable_alone(sampled: SampledResult) -> None:
    own = sampled.assessment
    assert own.importance is not None
    for k_hat, expected in ((0.5, "by importance sampling"), (0.9, "not reliable: k-hat 0.90")):
        importance = replace(own.importance, k_hat=np.full(6, k_hat))
        result = replace(sampled, assessment=replace(own, importance=importance))
        (line,) = (line for line in screen(result).splitlines() if "PSIS-LOO" in line)
        assert expected in line
        psis = result.to_dict()["leave_one_out"]["psis"]
        assert (psis["log_score"] is None) == (k_hat > 0.7)


def test_products_of_constants_leave_small_exponents_out(sampled: SampledResult) -> None:
    c = replace(sampled.assessment.combinations[0], exponents=np.array([0.03, 1.0, -0.5]))
    assert product_text(("E1", "E2", "G12"), c) == "E2 G12^-0.5"


_PLAIN = """
import json, sys, xarray
import arviz_stats as az
data = xarray.open_datatree(sys.argv[1])
summary = az.summary(data, round_to="none")
ours = [name for name in sys.modules if name.startswith("cpam_bayes")]
psens = {k: float(v) for k, v in az.psense(data, group="likelihood").items()}
dims = {g: {k: list(v.dims) for k, v in data[g].items()} for g in data.children}
chains = data.posterior.sizes["chain"]
modes = data.observed_data["mode"].values.tolist()
attrs = {k: str(v) for k, v in (data.attrs | data.posterior.attrs).items()}
mean = {k: float(v) for k, v in summary["mean"].items()}
r_hat = {k: float(v) for k, v in summary["r_hat"].items()}
unit = data.posterior["E1_GPa"].attrs["unit"]
print(json.dumps([ours, mean, r_hat, chains, psens, dims, modes, attrs, unit]))
"""


def test_the_file_opens_in_arviz_without_this_package(sampled: SampledResult, tmp_path: Path) -> None:
    replace(sampled, seed=7).to_arviz().to_netcdf(tmp_path / "posterior.nc")
    alone = [sys.executable, "-c", _PLAIN, "posterior.nc"]
    said = json.loads(subprocess.check_output(alone, cwd=tmp_path))
    ours, mean, r_hat, chains, psens, dims, modes, attrs, unit = said
    assert ours == []
    for c in sampled.constants.values():
        name, factor = {"E1": ("E1_GPa", 1e-9), "nu12": ("nu12", 1.0)}[c.name]
        # thinned draws of the same chains; arviz rounds to three decimals
        assert mean[name] == pytest.approx(c.value * factor, abs=0.3 * c.sd * factor + 5e-4)
    assert unit == "GPa"
    # a stranger's arviz, which knows of chains only, comes to the R-hat of the ensembles
    assert dims["posterior"]["E1_GPa"] == ["chain", "draw"]
    assert chains == sampled.result.chain.shape[0]
    assert max(r_hat.values()) == pytest.approx(sampled.result.diagnostics.r_hat, abs=0.005)
    by_mode = {"frequencies_hz": ["chain", "draw", "mode"]}
    assert dims["log_likelihood"] == dims["posterior_predictive"] == dims["prior_predictive"] == by_mode
    assert set(dims["constant_data"]) == set(SIZES)
    assert dims["observed_data"] == {"frequencies_hz": ["mode"]}
    for group in ("posterior", "prior", "log_prior"):
        assert set(dims[group]) == {"E1_GPa", "nu12", *SIZES, "frequency_scale", "relative_std"}
        assert dims[group]["nu12"] == ["chain", "draw"]
    assert modes == [f"{i} {m.label}" for i, m in enumerate(sampled.modes[:6], 1)]
    versions = {f"{n}_version" for n in ("cpam_bayes", "numpy", "scipy", "emcee", "arviz_base")}
    assert versions | {"seed", "problem_hash", "noise", "noise_degrees_of_freedom"} <= set(attrs)
    assert attrs["seed"] == "7"
    # the constants' sensitivity to the likelihood, which takes no other draws, is that of the screen
    told = {s.name: s for s in sampled.assessment.power_scaling}
    assert psens["E1_GPa"] == pytest.approx(told["E1"].likelihood, rel=1e-6)


@pytest.mark.slow
def test_densities_in_the_file_add_up(sampled: SampledResult, gappy: SampledResult) -> None:
    for result in (sampled, gappy):
        data = result.to_arviz()
        likelihood = data["log_likelihood"].to_dataset().to_dataarray()
        likelihood = likelihood.sum([d for d in likelihood.dims if d not in ("chain", "draw")])
        prior = data["log_prior"].to_dataset().to_dataarray().sum("variable")
        lp = data.sample_stats["lp"]
        np.testing.assert_allclose(lp - likelihood - prior, 0.0, atol=1e-8)
        whole = result.posterior.log_prob(thinned(result.result).flat)
        np.testing.assert_allclose(lp.values.ravel(), whole, atol=1e-8)


def test_the_same_posterior_gives_the_same_file(sampled: SampledResult, tmp_path: Path) -> None:
    written = []
    for name in ("first", "again"):
        (tmp_path / name).mkdir()
        sampled.to_arviz().to_netcdf(tmp_path / name / "posterior.nc")
        written.append((tmp_path / name / "posterior.nc").read_bytes())
    assert written[0] == written[1]


def test_prior_draws_in_the_file_are_within_the_support(sampled: SampledResult) -> None:
    prior = sampled.to_arviz().prior
    assert prior.sizes["draw"] > 900  # the constraints (9) leave out few
    nu = prior["nu12"].values
    assert nu.mean() == pytest.approx(0.33, abs=4 * 0.01 / np.sqrt(900))
    assert np.all((prior["E1_GPa"] >= 10.0) & (prior["E1_GPa"] <= 200.0))


def test_the_hash_in_the_file_is_of_the_problem_and_not_of_the_chain(sampled: SampledResult) -> None:
    other = replace(
        sampled,
        result=replace(
            sampled.result, chain=sampled.result.chain[:, 3:], log_prob=sampled.result.log_prob[:, 3:]
        ),
    )
    first, second = (
        replace(r, seed=s).to_arviz().attrs["problem_hash"] for r, s in ((sampled, 0), (other, 1))
    )
    assert first == second
    wider = replace(sampled.posterior, parameters=sampled.posterior.parameters)
    parameters = tuple(
        replace(p, prior=Uniform(5e9, 300e9)) if p.name == "E1" else p for p in wider.parameters.parameters
    )
    wider = replace(wider, parameters=ParameterSet(parameters))
    assert replace(sampled, posterior=wider).to_arviz().attrs["problem_hash"] != first


@pytest.mark.slow
def test_a_list_that_may_lack_modes_has_one_likelihood_and_no_pareto_diagnostics(
    gappy: SampledResult,
) -> None:
    assert gappy.assessment.importance is None
    data = gappy.to_arviz()
    assert {name: v.dims for name, v in data["log_likelihood"].items()} == {"list": ("chain", "draw")}
    assert [m.split()[0] for m in data.observed_data["mode"].values] == ["1", "2", "4", "5", "6"]
    assert (data.attrs | data.posterior.attrs)["list_is_complete"] == 0
    document = gappy.to_dict()
    assert document["leave_one_out"]["psis"] is None
    assert len(gappy.assessment.left_out.residual) == 5
    (missed,) = document["missed_modes"]
    (said,) = (line for line in gappy.report().summary.lines if missed["label"] in line)
    assert f"{missed['label']} near {missed['predicted_hz']:.3g}" in said


@pytest.mark.slow
def test_a_slip_of_the_file_is_named_and_corrected(tmp_path: Path) -> None:
    listed = plate("p")
    listed["measurement"]["frequencies_hz"] = forward(
        {**listed, "plate": {**listed["plate"], "edges": "CFFF"}}, N_MODES
    ).frequencies.tolist()
    answer = sample(written(tmp_path / "p.toml", listed), seed=0, settings=SETTINGS)
    assert [(slip.kind, slip.edits) for slip in answer.explained_by] == [
        ("clamped", {("plate", "edges"): "CFFF"})
    ]
    assert "With the plate clamped at x = 0, not free (CFFF) it fits to" in answer.slips[0]
    assert answer.report().summary.next_step == (
        "correct the plate file, as in corrected.toml in the directory of --out."
    )
    assert 'edges = "CFFF"' in answer.texts()["corrected.toml"]
    assert [slip["slip"] for slip in answer.to_dict()["explained_by"]] == ["clamped"]


def test_fewer_frequencies_than_unknowns_are_allowed_and_the_prior_is_said_to_decide() -> None:
    specimen = builtin("A1")
    assert specimen.measurement is not None
    one = replace(
        specimen.measurement,
        frequencies=specimen.measurement.frequencies[:1],
        labels=("",),
        relative_std=0.01,
    )
    found = sample(replace(specimen, measurement=one), seed=0, settings=SETTINGS)
    assert found.notices[0] == Notice("few_frequencies", "slip", {"frequencies": 1, "unknowns": 2})
    assert found.assessment.combinations[1].contraction < 1e-6
    assert "the prior" in screen(found)
    found.figures()
    json_text(found.to_dict())
