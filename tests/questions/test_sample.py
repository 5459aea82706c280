"""A sampled posterior as screen, document, figures and NetCDF, and `identify --backend emcee`."""

import copy
import json
import re
import subprocess
import sys
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

import cpam_bayes as cb
from cpam_bayes.answer import Notice, Verdict
from cpam_bayes.cli import prepare
from cpam_bayes.inference.assessment import thinned
from cpam_bayes.inference.completeness import profile_likelihoods
from cpam_bayes.inference.sampling import basis_notices
from cpam_bayes.parameters import ParameterSet, TruncatedNormal, Uniform
from cpam_bayes.plate import builtin
from cpam_bayes.questions.forward import forward
from cpam_bayes.questions.identify import sample
from cpam_bayes.questions.identify.posterior import product_text
from cpam_bayes.render.report import json_text
from cpam_bayes.render.sentences import determined_text
from cpam_bayes.render.terminal import plain_text
from tests.answers import CHAINS as SETTINGS
from tests.batches.plates import N_MODES, plate, written
from tests.plate_file import MEASURED, described, refused
from tests.plate_file import PLATE as WITHOUT_LIST

SIZES = ("length_mm", "width_mm", "thickness_mm", "density_kg_m3")


@pytest.fixture(scope="module")
def sampled():
    """A1 with a normal prior of Poisson's ratio and inferred noise."""
    e1, nu12 = builtin("A1").unknowns.parameters
    unknowns = ParameterSet((e1, replace(nu12, prior=TruncatedNormal(0.33, 0.01, 0.15, 0.4))))
    return sample(replace(builtin("A1"), unknowns=unknowns), seed=0, settings=SETTINGS)


def with_list(frequencies, **changes):
    """A1 with some of its frequencies, known to 1 %."""
    own, labels = builtin("A1"), ("",) * len(frequencies)
    known = {"frequencies": frequencies, "labels": labels, "relative_std": 0.01, **changes}
    return replace(own, measurement=replace(own.measurement, **known))


@pytest.fixture(scope="module")
def gappy():
    f = np.delete(builtin("A1").measurement.frequencies, 2)
    return sample(with_list(f, complete=False), seed=0, settings=SETTINGS)


def without_seconds(document):
    if isinstance(document, dict):
        kept = {key: value for key, value in document.items() if not key.startswith("seconds")}
        return {key: without_seconds(value) for key, value in kept.items()}
    return document


def test_the_document_has_what_is_promised_and_profiles_on_the_whole_basis(sampled):
    document = json.loads(json_text(sampled.to_dict()))
    assert 0.99 < document["evidence"]["exact_fraction"] <= 1.0 + 1e-9
    drawn = {drawing.name for drawing in sampled.drawings()}
    assert drawn == {"posterior", "marginals_and_profiles", "left_out", "modes", "plate"}
    e1, shown = sampled.constants["E1"], document["constants"]["E1_GPa"]
    expected = [1e9 * shown[key] for key in ("mean", "q025", "q975")]
    assert (e1.value, *e1.interval) == pytest.approx(expected, rel=1e-12)
    prior = document["constants"]["nu12"]["prior"]
    assert (prior["kind"], prior["sd"]) == ("truncated normal", pytest.approx(0.01, rel=0.01))
    assert "0.33 +- 0.01 in 0.15 to 0.4" in sampled.summary(verbose=True)
    # times appear only under keys that say so
    slower = replace(sampled, seconds=9.0 * sampled.seconds, seconds_sampling=9.0 * sampled.seconds_sampling)
    again = json.loads(json_text(slower.to_dict()))
    once, nine_times = (of["diagnostics"]["seconds_sampling"] for of in (document, again))
    assert nine_times == pytest.approx(9.0 * once)
    assert without_seconds(again) == without_seconds(document)
    assert set(document["identifiability"]["profiles"]) == {"E1_GPa", "nu12"}
    assert set(document["nuisance"]) == {*SIZES, "frequency_scale"}
    assert len(document["identifiability"]["combinations"]) == 2 + len(document["nuisance"])
    assert len(document["frequencies"]) == 6
    for row in document["frequencies"]:
        assert 0.0 < row["left_out"]["leverage"] < 1.0
        # an omitted mode is predicted no better than an included one, on the same side
        assert row["left_out"]["residual_percent"] / row["residual_percent"] > 1.0
    # the profile of Poisson's ratio spans its search interval, far beyond the draws of a narrow basis
    x, log_prob = sampled.result.draws, sampled.result.log_prob.ravel()
    again = profile_likelihoods(sampled.posterior, ("E1", "nu12"), x, log_prob)
    for found, expected in zip(sampled.assessment.profiles, again, strict=True):
        np.testing.assert_array_equal(found.drop, expected.drop)


def test_what_an_answer_rests_on_is_told(sampled):
    evidence = replace(sampled.evidence, exact_fraction=0.6)
    assert basis_notices(evidence) == (Notice("narrow_basis", facts={"fraction": 0.6}),)
    assert basis_notices(sampled.evidence) == ()
    mode = sampled.pairing.mode.copy()  # peaks that are no modes determine nothing
    mode[2] = -1
    unpaired = replace(sampled, pairing=replace(sampled.pairing, mode=mode))
    for result, n in ((sampled, 6), (unpaired, 5)):
        assert f"The {n} frequencies determine" in result.report().summary.headline
    own = sampled.assessment  # importance sampling is quoted only if reliable
    for k_hat, expected in ((0.5, "by importance sampling"), (0.9, "not reliable: k-hat 0.90")):
        importance = replace(own.importance, k_hat=np.full(6, k_hat))
        result = replace(sampled, assessment=replace(own, importance=importance))
        (line,) = (line for line in result.summary(verbose=True).splitlines() if "PSIS-LOO" in line)
        assert expected in line
        assert (result.to_dict()["leave_one_out"]["psis"]["log_score"] is None) == (k_hat > 0.7)
    product = replace(own.combinations[0], exponents=np.array([0.03, 1.0, -0.5]))  # omits small exponents
    assert product_text(("E1", "E2", "G12"), product) == "E2 G12^-0.5"


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


def test_the_file_opens_in_arviz_without_this_package(sampled, tmp_path):
    replace(sampled, seed=7).to_arviz().to_netcdf(tmp_path / "posterior.nc")
    alone = [sys.executable, "-c", _PLAIN, "posterior.nc"]
    said = json.loads(subprocess.check_output(alone, cwd=tmp_path))
    ours, mean, r_hat, chains, psens, dims, modes, attrs, unit = said
    assert (ours, unit) == ([], "GPa")
    for c in sampled.constants.values():
        name, factor = {"E1": ("E1_GPa", 1e-9), "nu12": ("nu12", 1.0)}[c.name]
        # thinned draws of the same chains; arviz rounds to three decimals
        assert mean[name] == pytest.approx(c.value * factor, abs=0.3 * c.sd * factor + 5e-4)
    assert chains == sampled.result.chain.shape[0]  # arviz, knowing only chains, gives the ensembles' R-hat
    assert max(r_hat.values()) == pytest.approx(sampled.result.diagnostics.r_hat, abs=0.005)
    by_mode = {"frequencies_hz": ["chain", "draw", "mode"]}
    assert dims["log_likelihood"] == dims["posterior_predictive"] == dims["prior_predictive"] == by_mode
    assert set(dims["constant_data"]) == set(SIZES)
    assert dims["observed_data"] == {"frequencies_hz": ["mode"]}
    names = ("E1_GPa", "nu12", *SIZES, "frequency_scale", "relative_std")
    for group in ("posterior", "prior", "log_prior"):
        assert dims[group] == {name: ["chain", "draw"] for name in names}
    assert modes == [f"{i} {m.label}" for i, m in enumerate(sampled.modes[:6], 1)]
    versions = {f"{n}_version" for n in ("cpam_bayes", "numpy", "scipy", "emcee", "arviz_base")}
    assert versions | {"seed", "problem_hash", "noise", "noise_degrees_of_freedom"} <= set(attrs)
    assert attrs["seed"] == "7"
    # the constants' sensitivity to the likelihood, which uses the same draws, is that of the screen
    told = {s.name: s for s in sampled.assessment.power_scaling}
    assert psens["E1_GPa"] == pytest.approx(told["E1"].likelihood, rel=1e-6)


@pytest.mark.slow
def test_densities_in_the_file_add_up(sampled, gappy):
    for result in (sampled, gappy):
        data = result.to_arviz()
        likelihood = data["log_likelihood"].to_dataset().to_dataarray()
        likelihood = likelihood.sum([d for d in likelihood.dims if d not in ("chain", "draw")])
        prior = data["log_prior"].to_dataset().to_dataarray().sum("variable")
        lp = data.sample_stats["lp"]
        np.testing.assert_allclose(lp - likelihood - prior, 0.0, atol=1e-8)
        whole = result.posterior.log_prob(thinned(result.result).flat)
        np.testing.assert_allclose(lp.values.ravel(), whole, atol=1e-8)


@pytest.mark.slow
def test_a_list_that_may_lack_modes_has_one_likelihood_and_no_pareto_diagnostics(gappy):
    assert gappy.assessment.importance is None
    data, document = gappy.to_arviz(), gappy.to_dict()
    assert {name: v.dims for name, v in data["log_likelihood"].items()} == {"list": ("chain", "draw")}
    assert [m.split()[0] for m in data.observed_data["mode"].values] == ["1", "2", "4", "5", "6"]
    assert (data.attrs | data.posterior.attrs)["list_is_complete"] == 0
    assert document["leave_one_out"]["psis"] is None
    assert len(gappy.assessment.left_out.residual) == 5
    (missed,) = document["missed_modes"]
    (said,) = (line for line in gappy.report().summary.lines if missed["label"] in line)
    near = re.search(re.escape(missed["label"]) + r" near ([\d.]+) Hz", said)
    assert float(near[1]) == pytest.approx(missed["predicted_hz"], abs=0.6)


def test_the_same_posterior_gives_the_same_file_with_prior_draws_and_a_hash_of_the_problem(sampled, tmp_path):
    data = sampled.to_arviz()
    for name in ("first.nc", "again.nc"):
        sampled.to_arviz().to_netcdf(tmp_path / name)
    assert (tmp_path / "first.nc").read_bytes() == (tmp_path / "again.nc").read_bytes()
    assert data.prior.sizes["draw"] > 900  # the constraints (9) reject few
    assert data.prior["nu12"].values.mean() == pytest.approx(0.33, abs=4 * 0.01 / np.sqrt(900))
    assert np.all((data.prior["E1_GPa"] >= 10.0) & (data.prior["E1_GPa"] <= 200.0))
    # the hash does not include the chain
    chain, log_prob = (values[:, 3:] for values in (sampled.result.chain, sampled.result.log_prob))
    shorter = replace(sampled, seed=1, result=replace(sampled.result, chain=chain, log_prob=log_prob))
    own = sampled.posterior.parameters.parameters
    wider = ParameterSet(tuple(replace(p, prior=Uniform(5e9, 300e9)) if p.name == "E1" else p for p in own))
    other = replace(sampled, posterior=replace(sampled.posterior, parameters=wider))
    hashes = [result.to_arviz().attrs["problem_hash"] for result in (shorter, other)]
    assert [each == data.attrs["problem_hash"] for each in hashes] == [True, False]


@pytest.mark.slow
def test_a_slip_of_the_file_is_named_and_corrected(tmp_path):
    own = plate("p")
    clamped = {**own, "plate": {**own["plate"], "edges": "CFFF"}}
    own["measurement"]["frequencies_hz"] = forward(clamped, N_MODES).frequencies.tolist()
    answer = sample(written(tmp_path / "p.toml", own), seed=0, settings=SETTINGS)
    edits = {("plate", "edges"): "CFFF"}
    assert [(slip.kind, slip.edits) for slip in answer.explained_by] == [("clamped", edits)]
    assert "With the plate clamped at x = 0, not free (CFFF) it fits to" in answer.slips[0]
    told = "correct the plate file, as in corrected.toml in the directory of --out."
    assert answer.report().summary.next_step == told
    assert 'edges = "CFFF"' in answer.texts()["corrected.toml"]
    assert [slip["slip"] for slip in answer.to_dict()["explained_by"]] == ["clamped"]


def test_fewer_frequencies_than_unknowns_are_allowed_and_the_prior_is_said_to_decide():
    found = sample(with_list(builtin("A1").measurement.frequencies[:1]), seed=0, settings=SETTINGS)
    assert found.notices[0] == Notice("few_frequencies", "slip", {"frequencies": 1, "unknowns": 2})
    assert found.assessment.combinations[1].contraction < 1e-6
    assert "the prior" in found.summary(verbose=True)
    found.figures()
    json_text(found.to_dict())


PLATE = (WITHOUT_LIST + MEASURED).replace(
    "nu12 = [0.15, 0.4]", "nu12 = { mean = 0.3, sd = 0.05, bounds = [0.15, 0.4] }"
)
EMCEE = ("--backend", "emcee", "--quiet", "--steps", "200")


@pytest.fixture
def plate_file(plate_file):
    return partial(plate_file, text=PLATE)


@pytest.mark.slow
def test_sizes_stand_apart_from_the_constants_and_noise_has_a_scale_and_a_shape(plate_file):
    sizes = ("[material]", "[plate.sd]\nthickness_mm = 0.03\nwidth_mm = 0.1\n\n[material]")
    noise = ("--likelihood", "absolute", "--noise", "student-t")
    answer = prepare(("identify", plate_file(sizes), *EMCEE, *noise)).args[0]()
    document, report = answer.to_dict(), answer.report()
    assert list(document["constants"]) == ["E1_GPa", "nu12"]
    assert list(document["nuisance"]) == ["width_mm", "thickness_mm"]
    thickness = document["nuisance"]["thickness_mm"]
    assert thickness["reference"] == pytest.approx(3.0)
    assert thickness["mean"] == pytest.approx(3.0, abs=0.02)
    assert thickness["sd"] == pytest.approx(0.03, rel=0.4)  # frequencies say nothing about it beside E1
    (first,) = report.summary.tables
    assert [row[0] for row in first.rows] == ["E1", "nu12"]
    assert (document["noise"]["name"], document["degrees_of_freedom"]) == ("absolute_sd_hz", 4.0)
    assert 0.5 < document["noise"]["mean"] < 20.0
    shown = [plain_text(t) for section in report.sections for t in section.tables if t.rows]
    assert any("Hz, inferred, Student-t with 4" in text for text in shown)


STATED = ("resolution_hz = 1.0", "relative_std = 0.01")
TWICE = "measurement.relative_std: the absolute likelihood infers"
LABELLED = ("resolution_hz = 1.0", 'labels = ["(1,1)", "", "", "(9,9)", "", ""]')
NO_MODE = "measurement.labels: received '(9,9)' for one frequency, no mode of the model has it"


@pytest.mark.parametrize(
    ("change", "options", "said"),
    [
        (STATED, (*EMCEE, "--likelihood", "absolute"), TWICE),
        (LABELLED, EMCEE, NO_MODE),
        (LABELLED, ("--quiet",), "(1,1) at 11"),
        (("plate 7", "plate \\u001b[31m7"), EMCEE, r'name: malformed, received "plate \u001b'),
        (("plate 7", "plate \\u202e7"), EMCEE, r"\u202e7"),
    ],
)
def test_what_cannot_be_is_refused_in_one_line(run, plate_file, change, options, said):
    answer = run("identify", plate_file(change), *options)
    refused(answer, said)
    assert answer[2].replace("\n", "").isprintable()


@pytest.mark.slow
@pytest.mark.parametrize("options", [EMCEE, ("--quiet",)])
def test_labels_put_modes_beside_their_frequencies(run, plate_file, options):
    labels = 'labels = ["(1,1)", "", "", "(1,2)", "(2,1)", ""]'  # exchanged in the model
    rows = json.loads(run("identify", plate_file(("resolution_hz = 1.0", labels)), *options, "--json")[1])
    fourth, fifth = rows["frequencies"][3:5]
    assert (fourth["label"], fifth["label"]) == ("(1,2)", "(2,1)")
    assert fourth["predicted_hz"] > fifth["predicted_hz"]


@pytest.mark.slow
def test_a_store_serves_one_problem_and_a_damaged_round_or_a_full_disk_costs_no_answer(
    run, plate_file, tmp_path, monkeypatch
):
    store = tmp_path / "store"
    command = ("identify", plate_file(), *EMCEE[:-1], "40", "--json", "--store")
    constants = json.loads(run(*command, store)[1])["constants"]
    refused(run(*command, store, "--noise", "student-t"), "holds another problem")
    first = store / "round_0000.arrays"
    first.write_bytes(first.read_bytes()[:700])
    _, out, err = run(*command, store)
    assert json.loads(out)["constants"] == constants
    assert f"warning: {first} was damaged: it is set aside as round_0000.arrays.damaged" in err
    moved = Path.replace

    def full(self, target):
        if self.parent.name == "full":
            raise OSError(28, "No space left on device")
        return moved(self, target)

    monkeypatch.setattr(Path, "replace", full)
    status, out, err = run(*command, tmp_path / "full")
    document = json.loads(out)
    assert (status, document["constants"]) == (1, constants)
    assert any("cannot be written (No space left on device)" in text for text in document["warnings"])
    assert "cannot be written" in err


@pytest.mark.slow
def test_a_list_that_lacks_a_mode_is_put_in_doubt(run, plate_file):
    status, _, err = run("identify", plate_file(("167, 218", "167"), STATED), *EMCEE)
    assert status in (0, 1)
    assert "to lack the mode (2,0)+(0,2) near 2" in err
    assert "modes may be missing from it" in err


EXACT = {"length_mm": 0.0, "width_mm": 0.0, "density_kg_m3": 0.0}
UNKNOWNS = {"E1_GPa": [60.0, 200.0], "E2_GPa": [5.0, 20.0], "nu12": [0.1, 0.5], "G12_GPa": [2.0, 10.0]}
MATERIAL = {"E1_GPa": 120.0, "E2_GPa": 9.0, "nu12": 0.3, "G12_GPa": 5.0, "name": "carbon"}
FIRST = described((300.0, 220.0, 2.0), 1550.0, MATERIAL, layup="[0_8]", unknowns=UNKNOWNS)
# one error of all moduli: their ratios are known better
FIRST["plate"]["sd"] = {**EXACT, "thickness_mm": 0.04}


def listed(plate, n, rng):
    f = cb.forward(plate, n_modes=n).frequencies
    noisy = np.sort(f * (1.0 + 0.003 * rng.standard_normal(n))).tolist()
    plate["measurement"] = {"frequencies_hz": noisy, "relative_std": 0.003, "frequency_scale_sd": 0.0}


@pytest.mark.slow
@pytest.mark.weekly
def test_the_posterior_of_a_former_plate_as_prior_gives_what_both_lists_give_together(tmp_path):
    """Sisters without scatter; the former one's badly gauged thickness correlates its moduli.
    The second list determines E1 and G12 well; through the correlations E2 is then known too."""
    rng = np.random.default_rng(1)
    first, second = (copy.deepcopy(FIRST) | {"name": name} for name in ("first", "second"))
    second["plate"] |= {"edges": "CFFF", "width_mm": 60.0, "sd": {**EXACT, "thickness_mm": 0.0}}
    listed(first, 8, rng)
    listed(second, 4, rng)
    together = cb.identify(first, second, seed=0, scatter=1e-4).constants
    cb.identify(first, seed=0).save(tmp_path)
    second["material"]["posterior"] = str(tmp_path / "posterior.nc")
    after = cb.read_plate(second)
    answers = (cb.identify(after, seed=0).constants, cb.sample(after, seed=0).constants)
    decided = "not determined: the former plate decides"
    for name, expected in together.items():
        for answer in answers:
            # at least 600 effective draws of the former posterior, and the normal form of its prior
            assert answer[name].value == pytest.approx(expected.value, abs=0.15 * expected.sd), name
            assert answer[name].sd == pytest.approx(expected.sd, rel=0.1), name
            # this list determines the moduli ten times better than the former plate did, and not nu12
            assert (answer[name].verdict is Verdict.DATA) == (name != "nu12"), name
            assert determined_text(answer["nu12"]) == decided
    vague = copy.deepcopy(second)
    vague["measurement"]["relative_std"] = 0.2
    assert {determined_text(c) for c in cb.identify(vague, seed=0).constants.values()} == {decided}
    independent = tuple(replace(p, coupled=None) for p in after.unknowns.parameters)
    without = replace(after, unknowns=ParameterSet(independent))
    assert cb.identify(without, seed=0, residuals="whitened").constants["E2"].sd > 2.0 * together["E2"].sd
