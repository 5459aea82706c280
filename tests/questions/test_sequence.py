"""`sequence`: its report, document, pictures and posterior file."""

import json
from dataclasses import replace

import numpy as np
import pytest
import xarray
from scipy.stats import chi2

from cpam_bayes.answer import Notice
from cpam_bayes.inference.sampling import command_of_draws
from cpam_bayes.questions.identify.pso import identify
from cpam_bayes.questions.sequence import stacking_result
from cpam_bayes.render.files import save, staging
from cpam_bayes.stacking.notices import stacking_notices
from cpam_bayes.stacking.posterior import EMCEE, stacking_posterior
from cpam_bayes.stacking.queries import best_fit, given_layup
from cpam_bayes.stacking.records import StackingSettings, SurrogateCheck
from tests.stacking.cases import TRUE, answer, mixture, specimen

pytestmark = pytest.mark.slow


def notices(answer, mixture):
    return {n.code: n.facts for n in stacking_notices(answer, mixture, best_fit(answer))}


def tables(result):
    return {t.title: t for section in result.report().sections for t in section.tables}


def work(result):
    return dict(tables(result)["All stacking sequences"].rows)  # type: ignore[arg-type]


def test_an_error_of_a_size_does_to_the_constants_what_identify_says_of_the_most_probable_layup():
    result = stacking_result(answer(), mixture(), None, 0, 5)
    known = result.most_probable
    alone = replace(known, material=replace(known.material, known=False))  # no references here
    identified = identify(alone, seed=1, residuals="relative").estimate.scale_errors
    for one, other in zip(result.scale_errors, identified, strict=True):
        assert one.name == other.name
        if one.name not in ("length", "width"):  # their powers are those at the optimum, which are not one
            assert one.shift == pytest.approx(other.shift, abs=0.005)


def test_the_document_has_what_the_contract_names_and_the_first_screen_its_answer():
    own = answer()
    result = stacking_result(own, mixture(), None, 0, 5)
    assert {d.name for d in result.drawings()} == {"angles", "constants", "credible_set", "plate"}
    document = json.loads(json.dumps(result.to_dict(), allow_nan=False))
    assert (document["enumerated"], document["credible_95_count"]) == (36, own.credible_count)
    assert [s["sampled_by"] for s in document["sequences"]] == 3 * ["emcee"] + 2 * ["importance sampling"]
    assert set(document["sequences"][0]["constants"]) == {"E1_GPa", "E2_GPa", "nu12", "G12_GPa"}
    # none of the rejected sequences is within 18 nats of the best
    assert document["unaccounted_probability"] < 36 * np.exp(-18.0)
    assert 0.0 < document["basis_error"] < 1e-3
    np.testing.assert_allclose(np.sum(document["angle_marginals"], axis=1), 1.0)
    assert document["outer_plies_better_determined"] is True
    e1 = document["constants"]["E1_GPa"]
    assert e1["q025"] < e1["mean"] < e1["q975"]
    assert e1["mean"] == pytest.approx(result.mixture.parameters[:, 0].mean() / 1e9)
    assert (document["noise_percent"], document["noise_inferred"]) == (pytest.approx(1.0, rel=1e-3), False)
    # the list is the plate's own without noise, with two frequencies more than constants
    assert chi2.isf(document["p_value"], 2) < 0.1
    assert work(result)["noise"].startswith("1.0 % of a frequency, from the plate file; alone it gives")
    summary = result.report().summary  # the first screen has the layup, its probability and the constants
    constants, sequences = summary.tables
    assert [row[0] for row in constants.rows] == ["E1", "E2", "nu12", "G12"]
    together = float(own.probability[0] * own.multiplicity[0])
    assert len(sequences.rows) == 5, "as many as were asked for"
    assert sequences.rows[0] == ("1", "-30/60", f"{together:.3g}", str(own.multiplicity[0] - 1))
    assert summary.headline.startswith(f"Probability {together:.2g}")
    assert "-30/60, or another layup" in summary.headline
    assert f"On the 30-degree grid {own.credible_count} of 36 layups" in summary.lines[0]
    assert work(result)["constants"].startswith("emcee on the first 3 of the list")
    (said,) = tables(result)["Outer and inner plies"].rows
    assert said[0].startswith("outer angles are better determined than inner ones")
    assert result.to_dataframe()["angles_deg"][0] == [-30.0, 60.0]


def test_constants_over_all_sequences_have_emcee_and_the_printed_sequence_beside_them():
    own, mixed = answer(), mixture()
    wrong = replace(mixed.components[1], importance=mixed.components[0].importance)
    for components in (mixed.components, (*mixed.components[:1], wrong)):
        result = stacking_result(own, replace(mixed, components=components), None, 0, 5)
        table = tables(result)["Constants over all sequences"]
        at = table.headings.index("emcee vs importance sampling, standard errors")
        worst = result.to_dict()["mixture"]["worst_difference_in_standard_errors"]
        assert max(float(row[at]) for row in table.rows) == pytest.approx(worst, abs=0.05)
    printed = replace(mixed, given=mixed.components[0])
    result = stacking_result(own, printed, given_layup(own, np.array(TRUE)), 0, 5)
    document = result.to_dict()
    assert document["printed_sequence"]["rank"] == 1
    assert document["printed_sequence"]["constants"] == document["sequences"][0]["constants"]
    assert work(result)["printed"].startswith("30/-60: probability")
    assert "given the printed one" in tables(result)["Constants over all sequences"].headings


def of_list(frequencies, **more):
    own, labels = specimen(), ("",) * len(frequencies)
    measured = replace(own.measurement, frequencies=np.sort(frequencies), labels=labels, **more)
    settings = StackingSettings(draws=30, listed=12, log2_points=6)
    return stacking_posterior(replace(own, measurement=measured), 0, settings=settings)


def test_a_list_that_lacks_a_mode_is_paired_and_of_one_that_no_sequence_explains_the_next_step_is_a_check():
    every, few = specimen().measurement.frequencies, {"complete": False, "relative_std": 1e-3}
    found = of_list(np.delete(every, 2), **few)
    fit = best_fit(found)
    np.testing.assert_allclose(fit.predicted, np.delete(every, 2), rtol=1e-3)
    np.testing.assert_allclose(fit.missed, every[2:3], rtol=5e-3)
    assert chi2.isf(fit.p_value, 1) < 0.1
    result = stacking_result(found, mixture(), None, 0, 5)
    assert result.to_dict()["missed_modes"] == [{"predicted_hz": pytest.approx(fit.missed[0])}]
    assert len(tables(result)["Missing from the measured frequencies"].rows) == 1
    stray = of_list(np.append(np.delete(every, 2), every[3] * 1.1), **few)
    beside = stacking_result(stray, mixture(), None, 0, 5).to_dict()["frequencies"]
    assert [f["predicted_hz"] is None for f in beside].count(True) == 1
    assert notices(stray, mixture())["frequencies_without_mode"]["alone"] == 1
    off = specimen().measurement.frequencies * (1.0 + 0.03 * np.array(3 * [1.0, -1.0]))  # explained by none
    found = of_list(off, relative_std=2e-3)
    wrong, right = (stacking_result(each, mixture(), None, 0, 5) for each in (found, answer()))
    assert [n.severity for n in wrong.notices if n.code == "no_sequence_explains"] == ["slip"]
    of_wrong, of_right = (each.report().summary for each in (wrong, right))
    checked = "check the edges (free on all four edges), the layup, the grid of angles and the order"
    assert [each.next_step.startswith(checked) for each in (of_wrong, of_right)] == [True, False]
    assert of_wrong.headline.startswith("No layup on the grid explains the frequencies")
    assert ["do not use them" in each.lines[-1] for each in (of_wrong, of_right)] == [True, False]
    short = replace(right, notices=(Notice("few_frequencies", "slip", {"frequencies": 1, "unknowns": 4}),))
    assert short.report().summary.next_step.startswith("measure more modes: bounds and the grid")


def test_what_failed_disagrees_was_learned_badly_or_overlooked_is_warned_of():
    mixed = mixture()
    own = replace(answer(), log_evidence_error=np.zeros(len(answer().top)))
    assert notices(own, mixed) == {}
    first, second = mixed.components[:2]
    failed = replace(first, diagnostics=replace(first.diagnostics, converged=False))
    wrong = replace(second, importance=first.importance)
    found = notices(own, replace(mixed, components=(failed, wrong)))
    assert (found["sequence_chains"]["number"], found["sequence_disagrees"]["number"]) == (1, 2)
    sizes = {"training_size": 700, "fitted": 500, "sampled": 300}
    good = SurrogateCheck(**sizes, rms=0.1, largest=0.4, overlooked=0.1, correction=0.01, effective=0.98)
    assert notices(replace(own, check=good), mixed) == {}
    bad = replace(own, check=replace(good, rms=2.5, overlooked=1.2), unaccounted=4e-3)
    assert notices(bad, mixed) == {
        "rough_surrogate": {"rms": 2.5},
        "overlooked_sequence": {"better": 1.2},
        "sequences_left_out": {"probability": 4e-3},
    }
    assert stacking_result(bad, mixed, None, 0, 5).to_dict()["learned"]["overlooked_nats"] == 1.2


def test_draws_of_another_command_in_the_directory_are_kept_under_its_name(tmp_path):
    result = stacking_result(answer(), mixture(), None, 3, 5)
    file, kept = tmp_path / "posterior.nc", tmp_path / "identify_posterior.nc"
    file.write_text("no draws of anybody")
    result.save(tmp_path)
    assert command_of_draws(file) == "sequence"
    of_identify = result.to_arviz()
    of_identify.attrs["command"] = "identify"
    of_identify.to_netcdf(str(file))
    with staging(str(tmp_path)) as stage:
        (note,) = save(result, stage)
    assert note == f"{file} is now from sequence; that from identify is kept as identify_posterior.nc"
    result.save(tmp_path)
    assert (command_of_draws(file), command_of_draws(kept)) == ("sequence", "identify")
    assert sorted(path.name for path in tmp_path.glob("*.nc")) == ["identify_posterior.nc", "posterior.nc"]


def test_the_posterior_file_opens_in_plain_arviz(tmp_path):
    mixed = mixture()
    result = stacking_result(answer(), mixed, None, 3, 5)
    result.to_arviz().to_netcdf(tmp_path / "posterior.nc")
    data = xarray.open_datatree(str(tmp_path / "posterior.nc"))
    posterior = data.posterior
    assert posterior["angle_deg"].dims == ("chain", "draw", "ply")
    assert posterior.sizes["draw"] == len(mixed.parameters)
    np.testing.assert_allclose(posterior["E1_GPa"].values[0], result.mixture.parameters[:, 0] / 1e9)
    assert posterior["E1_GPa"].attrs["unit"] == "GPa"
    by = data.sample_stats["sampled_by"].values[0]
    assert np.mean(by == EMCEE) == pytest.approx(mixed.emcee_fraction, abs=1e-3)
    np.testing.assert_array_equal(posterior["component"].values[0], mixed.origin)
    listed = data.constant_data["sequence_angle_deg"].values  # angles are an image of the component's
    assert np.all(np.abs(posterior["angle_deg"].values[0][mixed.origin == 0]) == np.abs(listed[0]))
    np.testing.assert_allclose(data.constant_data["angle_marginal"].sum("angle"), 1.0)
    assert data.observed_data.sizes["mode"] == 6
    assert (data.attrs["seed"], len(data.attrs["problem_hash"])) == (3, 32)
