"""What a diagnosis says, as a document and on the screen, of cases whose truth is known."""

from __future__ import annotations

import json
import re
from dataclasses import replace

import numpy as np
import pytest

from cpam_bayes.diagnosis.answers.detectability import Detectable
from cpam_bayes.diagnosis.claim import Claim
from cpam_bayes.diagnosis.next_test.next_measurement import Candidate
from cpam_bayes.diagnosis.plates import diagnosis_result
from cpam_bayes.diagnosis.warnings import diagnosis_warnings
from cpam_bayes.effects import CATALOGUE
from cpam_bayes.formatting import significant
from cpam_bayes.identification.reliance import Reliance
from cpam_bayes.report.diagnosis.rows import (
    absorbed_biases,
    averaged_rows,
    catalogue_sd,
    hidden_causes,
)
from cpam_bayes.report.diagnosis.words import claim_sentence, probability_text, size_text
from cpam_bayes.report.documents import json_text
from cpam_bayes.report.sentences import contained_sentence
from tests.diagnosed import DRAWN, aluminium_case, diagnosed, listed

MISREAD = np.array([1.0, 1.0, 1.05, 1.0, 1.0, 1.0])


@pytest.fixture(scope="module")
def case():
    return aluminium_case()


@pytest.fixture(scope="module")
def clean(case):
    return diagnosed([listed(case, np.ones(6))], ["frequency_scale", "viscoelastic"])


@pytest.fixture(scope="module")
def misread(case):
    return diagnosed([listed(case, MISREAD)], ["outlier", "viscoelastic"])


@pytest.fixture(scope="module")
def false_peak(case):
    f = case.models.bare.predict(np.array([[69e9, 0.33]])).frequencies[0]
    with_false = np.concatenate((f[:2], [190.0], f[2:5]))
    return diagnosed([listed(case, with_false / f[:6])], ["mode_identity"], gain=False)


@pytest.fixture(scope="module")
def two_plates(case):
    twin = aluminium_case("plate 8")
    cases = [listed(case, MISREAD), listed(twin, np.ones(6), -DRAWN)]
    return diagnosed(cases, ["outlier"], gain=False)


def document(d, **more):
    result = replace(diagnosis_result(d, 3, **more), warnings=("mind this",))
    return json.loads(json_text(result.to_dict()))


def screen(d, **more):
    return diagnosis_result(d, 3, **more).summary(verbose=True)


def test_the_document_has_the_keys_of_the_contract(misread):
    found = document(misread)
    assert (found["command"], found["plate"], found["seed"]) == ("diagnose", "plate 7", 3)
    assert (found["claim"], found["causes"]) == ("named", ["outlier"])
    assert found["probability"] > 0.9
    assert found["warnings"] == ["mind this"]
    assert found["next_measurement"] == []
    for fit in (found["baseline"], found["extended"]):
        assert {"constants", "frequencies", "rms_percent", "log_evidence"} <= set(fit)
        assert set(fit["constants"]) == {"E1_GPa", "nu12"}
        for constant in fit["constants"].values():
            assert constant["q025"] < constant["mean"] < constant["q975"]
            assert {"sd", "prior_contraction", "reference"} <= set(constant)
    gain = found["gain"]
    assert gain["rms_percent_after"] < gain["rms_percent_before"] == found["baseline"]["rms_percent"]
    assert {"log_bayes_factor", "held_out_log_score_difference", "held_out_log_score_se"} <= set(gain)
    assert 0.0 <= gain["stable_share"] <= 1.0
    assert gain["held_out_hypotheses"] == misread.gain.n_hypotheses >= 2
    assert f"repeated without each frequency, among {misread.gain.n_hypotheses} hypotheses" in screen(misread)


def test_probabilities_of_all_hypotheses_sum_to_one_and_none_and_other_are_among_them(clean, misread):
    for d in (clean, misread):
        hypotheses = document(d)["hypotheses"]
        names = [h["cause"] for h in hypotheses]
        assert {"none", "other"} <= set(names)
        assert len(set(names)) == len(names)
        assert sum(h["probability"] for h in hypotheses) == pytest.approx(1.0, abs=1e-9)
        keys = {"log_bayes_factor", "parameters", "indistinguishable_from", "max_shift_percent"}
        assert all(keys <= set(h) for h in hypotheses)


def test_a_misread_frequency_is_named_with_its_size_in_percent(misread):
    outlier = next(h for h in document(misread)["hypotheses"] if h["cause"] == "outlier")
    assert outlier["variant"] == "frequency 3"
    size = outlier["parameters"]["misreading"]
    assert size["unit"] == "%"
    assert size["mean"] == pytest.approx(5.0, abs=3 * size["sd"])
    said = "The plate model lacks one thing: misread or mistyped frequency (outlier), "
    assert said in screen(misread)
    assert re.search(
        r"outlier\), 5\.\d+ \+- 0\.\d+ % \(frequency 3\); probability [>0-9. ]+\.", screen(misread)
    )


def test_the_extended_constants_come_back_to_the_truth(misread):
    # 69 GPa made the list; the plain model is pulled off by the misread frequency
    plain, extended = (document(misread)[fit]["constants"]["E1_GPa"] for fit in ("baseline", "extended"))
    assert extended["q025"] < 69.0 < extended["q975"]
    assert not plain["q025"] < 69.0 < plain["q975"]


def test_residuals_have_one_sign_and_the_kind_of_their_mode(misread):
    rows = document(misread)["baseline"]["frequencies"]
    assert len(rows) == 6
    for row in rows:
        assert row["kind"] == "bending"
        ratio = row["predicted_hz"] / row["measured_hz"]
        assert row["residual_percent"] == pytest.approx(100 * (ratio - 1), abs=1e-9)
        sd = np.hypot(row["noise_sd_hz"], row["predicted_sd_hz"])
        assert row["standardised"] == pytest.approx((row["predicted_hz"] - row["measured_hz"]) / sd)


def test_nothing_is_extended_where_nothing_is_claimed(clean):
    found = document(clean)
    assert (found["claim"], found["causes"]) == ("none", [])
    assert found["extended"] is None
    assert found["gain"] is None
    text = screen(clean)
    assert "No evidence of a model error" in text
    assert "extended" not in text
    assert diagnosis_warnings(clean) == ()


def test_constants_are_averaged_over_all_hypotheses_in_every_answer(clean, misread):
    for d in (clean, misread):
        averaged = document(d)["averaged"]
        assert set(averaged) == {"E1_GPa", "nu12"}
        for name, of in averaged.items():
            assert of["q025"] < of["mean"] < of["q975"]
            assert of["mean"] == pytest.approx(d.averaged[name.removesuffix("_GPa")][0] / scale(name))
    assert "averaged over all hypotheses by their probability" in screen(clean)
    assert "averaged" not in screen(misread)
    # a claim has the constants of its extended model, other answers the average
    assert clean.constants == clean.averaged
    assert misread.constants == misread.extended.constants


def test_residuals_are_held_against_the_stated_repeatability(clean, misread):
    found = document(misread)
    assert found["baseline"]["predictive_p"] < 1e-6 < 0.01 < found["extended"]["predictive_p"]
    assert document(clean)["baseline"]["predictive_p"] > 0.05
    assert "< 0.001, the chance of residuals as large with the stated repeatability" in screen(misread)


def test_probabilities_are_repeated_with_other_scales_of_the_priors(clean, misread):
    for d in (clean, misread):
        found = document(d)
        assert found["claim_stands"] is d.sensitivity.claim_stands
        for scales in ("scales_times_3", "scales_divided_by_3"):
            ranges = [h["probability_range"][scales] for h in found["hypotheses"]]
            assert sum(ranges) == pytest.approx(1.0, abs=1e-9)
            assert set(found["claims_by_prior_scales"][scales]) == {"claim", "causes", "probability"}
    assert document(misread)["claim_stands"] is True
    assert "in errors three times as large, or a third as large, leaves the claim as it is." in screen(
        misread
    )
    other = replace(
        misread.sensitivity,
        claim_stands=False,
        claims=(Claim("none", (), 0.6), Claim("class", ("outlier", "warp"), 0.95)),
    )
    text = screen(replace(misread, sensitivity=other))
    assert "changes the claim: three times as large, no evidence of a model error;" in text
    assert "misread or mistyped frequency (outlier); plate that is not flat (warp)." in text


def test_what_could_have_been_seen_is_told_of_every_cause(clean, misread):
    for d in (clean, misread):
        found = document(d)
        tested = [h["cause"] for h in found["hypotheses"] if h["cause"] not in ("none", "other")]
        assert [entry["cause"] for entry in found["detectable"]] == tested
        assert all(
            set(entry) == {"cause", "smallest", "unit", "probability_of_claim"}
            for entry in found["detectable"]
        )
        assert found["tested"]["causes"] == tested
        assert found["tested"]["hypotheses"] == len(d.weighed.tested)
    told = {entry["cause"]: entry for entry in document(clean)["detectable"]}
    # the constants imitate a clock that is off
    assert told["frequency_scale"] == {
        "cause": "frequency_scale",
        "smallest": None,
        "unit": "%",
        "probability_of_claim": 0.0,
    }
    parameter = misread.causes[0].hypothesis.parameters[0]
    entries = (
        Detectable("outlier", parameter, 0.0123, 0.96),
        Detectable("skew", parameter, 0.02, 0.95),
        Detectable("air", parameter, None, 0.3),
        Detectable("mode_identity", None, None, None),
    )
    text = screen(replace(clean, detectable=entries))
    assert "2 causes were weighed against the plate model as it stands" in text
    assert "would have shown, with 95 % probability: misread or mistyped frequency from 1.2 %" in text
    assert "These causes need not show at any size: air that moves with the plate." in text
    # the misread frequency would have been seen at its usual size of 2 %, the others not at theirs
    said = "An error may be there all the same: at their usual sizes, 1 of 2 causes would not have been seen."
    assert said in text
    assert re.search(r"mode missed, counted twice or swapped +mode_identity +has no size", text)
    assert "How large an error must be to show in these frequencies" in screen(misread)
    assert "These causes need not show" not in screen(misread)


def scale(name):
    return 1e9 if name.endswith("_GPa") else 1.0


def test_a_false_peak_belongs_to_no_mode_and_later_ones_to_the_mode_before(false_peak):
    rows = document(false_peak)["extended"]["frequencies"]
    assert [row["kind"] for row in rows] == ["bending", "bending", None, *3 * ["bending"]]
    assert rows[2]["predicted_hz"] is None
    assert rows[2]["residual_percent"] is None
    assert all(abs(row["residual_percent"]) < 1.0 for row in rows if row["predicted_hz"])
    text = screen(false_peak)
    assert "no mode" in text
    assert "is mode 3, (2,0)+(0,2)" in text


def test_several_plates_have_one_object_each_and_share_their_constants(two_plates):
    found = document(two_plates)
    assert [p["plate"] for p in found["plates"]] == ["plate 7", "plate 8"]
    assert "plate" not in found
    for fit in (found["baseline"], found["extended"]):
        plates = fit["plates"]
        assert len(plates) == 2
        for plate in plates:
            assert {"constants", "frequencies", "rms_percent", "log_evidence"} <= set(plate)
            assert len(plate["frequencies"]) == 6
        squares = [6 * plate["rms_percent"] ** 2 for plate in plates]
        assert np.sqrt(sum(squares) / 12) == pytest.approx(fit["rms_percent"], rel=1e-9)
        # a plate's own constant is the shared one within the scatter from plate to plate
        shared = fit["constants"]["E1_GPa"]["mean"]
        assert all(abs(p["constants"]["E1_GPa"]["mean"] / shared - 1) < 0.08 for p in plates)
    assert found["material_scatter"] == 0.02
    own = next(h for h in found["hypotheses"] if h["cause"] == "outlier")
    assert own["plates"] == ["plate 7"]
    assert "of plate 7" in found["sentence"]


def test_what_scales_all_frequencies_is_hidden_and_moves_the_stiffness_twice_as_much(clean):
    # f goes as the root of E: 1 % too high a clock is 2 % of E, and nothing of nu12
    (hidden,) = hidden_causes(clean)
    assert hidden.name == "frequency_scale"
    _, unit, per_unit = absorbed_biases(clean, hidden)
    assert unit == "%"
    assert per_unit["E1_GPa"] == pytest.approx(2.0, rel=0.02)
    assert per_unit["nu12"] == pytest.approx(0.0, abs=0.02)
    assert catalogue_sd(hidden) == 0.2
    (entry,) = document(clean)["absorbed"]
    assert entry["bias_percent"]["E1_GPa"] == pytest.approx(entry["at"] * per_unit["E1_GPa"])
    assert "Errors that the constants absorb" in screen(clean)
    assert "1 % of the analyser's frequency scale moves E1 by 2.0 %" in screen(clean)


def test_priors_of_families_causes_and_sizes_are_told(clean):
    priors = document(clean)["priors"]
    assert (priors["none"], priors["other"]) == (0.5, 0.05)
    assert priors["families"]["size"]["frequency_scale"] > 0
    size = priors["effects"]["frequency_scale"]["frequency_deviation"]
    assert (size["kind"], size["scale"], size["unit"]) == ("Student-t", 0.2, "%")
    gross = size["gross"]
    assert gross is None or (gross["fraction"], gross["scale"] > 1.0) == (0.1, True)


def test_every_claim_has_its_own_sentence(clean):
    def said(kind, causes, p):
        return claim_sentence(replace(clean, claim=Claim(kind, causes, p)))

    cannot = said("class", ("thickness", "density"), 0.95)
    assert "lacks one thing of 2, and these frequencies cannot tell which: thickness other than" in cannot
    assert "stated (thickness); density other than stated (density). Together" in cannot
    assert "0.950" in cannot
    alone = next(c for c in clean.causes if c.name == "viscoelastic")
    one = replace(
        alone,
        name="skew + viscoelastic",
        variant="frequency 5",
        hypothesis=replace(alone.hypothesis, cause="skew + viscoelastic"),
    )
    pair = claim_sentence(
        replace(clean, causes=(*clean.causes, one), claim=Claim("pair", ("skew", "viscoelastic"), 0.93))
    )
    assert "two things at once: corners that are not square (skew); " in pair
    assert f"(viscoelastic), {size_text(alone)} (frequency 5); probability 0.930." in pair
    assert size_text(alone)
    two = tuple(
        replace(alone, name=f"warp + {name}", probability=p) for name, p in (("skew", 0.5), ("damage", 0.4))
    )
    causes = (*clean.causes, replace(alone, name="warp", probability=0.05))
    with_pairs = replace(clean, causes=(*causes, *two), claim=Claim("named", ("warp",), 0.95))
    assert with_pairs.beside == {"skew": 0.5, "damage": 0.4}
    beside = claim_sentence(with_pairs)
    assert "lacks at least one thing: plate that is not flat (warp); probability 0.950. Something" in beside
    assert "beside it with probability 0.90, of which these frequencies cannot tell what it is" in beside
    assert "what it is: corners that are not square (skew), 0.50; local damage" in beside
    assert "tell what" not in claim_sentence(replace(with_pairs, causes=(*causes, two[0])))
    faint = (replace(two[0], probability=0.01),)
    assert "lacks one thing: plate" in claim_sentence(replace(with_pairs, causes=(*causes, *faint)))
    of_two = replace(with_pairs, claim=Claim("class", ("warp", "skew"), 0.95))
    assert of_two.beside == {"skew": 0.5, "damage": 0.4}
    assert "lacks at least one thing of 2" in claim_sentence(of_two)
    assert "no cause of the catalogue explains" in said("other", (), 0.97)
    undecided = said("undecided", ("viscoelastic",), 0.4)
    assert undecided.startswith("Undecided")
    assert "The plate model as it stands has probability" in undecided


def test_doubts_about_a_diagnosis_are_warned_of(misread):
    assert misread.extended is not None
    assert misread.gain is not None
    poor = replace(
        misread,
        extended=replace(misread.extended, predictive_p=0.001),
        gain=replace(misread.gain, stable=0.5),
    )
    found = " ".join(diagnosis_warnings(poor))
    assert "does not explain all" in found
    assert "without one frequency in 50 %" in found


def test_what_to_measure_next_is_shown_with_its_information(clean):
    next_one = Candidate("weigh", "weigh the plate to 0.1 g", 0.42, 1.1, 0.25)
    (told,) = document(clean, candidates=(next_one,))["next_measurement"]
    assert (told["name"], told["information_nats"], told["possible_nats"]) == ("weigh", 0.42, 1.1)
    text = screen(clean, candidates=(next_one,))
    assert "What to measure next" in text
    assert re.search(r"weigh the plate to 0.1 g +0.42 +1.10 +25 %", text)


@pytest.mark.parametrize(
    ("chances", "said"),
    [
        ((0.2, 0.45), "Do a further test: weigh; the chance that it decides is 45 %."),
        (
            (0.01, 0.06),
            "No single further test is likely to decide what is wrong: of the 2 that were computed the best "
            "chance is 6 %, with weigh.",
        ),
        ((0.06,), "One further test was computed and is not likely to decide: clamp, 6 %."),
    ],
)
def test_next_steps_begin_with_what_costs_nothing_and_end_with_the_likeliest_test(clean, chances, said):
    tests = tuple(
        Candidate(name, name, 1.0 - i, 2.0, chance)
        for i, (name, chance) in enumerate(zip(("clamp", "weigh"), chances, strict=False))
    )
    steps = diagnosis_result(clean, 3, candidates=tests).in_words().next_steps
    assert steps[0].startswith("Was an accelerometer")
    assert steps[-1] == said


def test_the_check_of_what_is_claimed_comes_before_other_measurements(misread):
    steps = diagnosis_result(misread, 3).in_words().next_steps
    assert (
        steps[0] == "Check for misread or mistyped frequency: read that peak again in the measured spectrum."
    )


def test_no_constant_is_determined_where_noise_as_stated_does_not_explain_the_misfit(case, clean):
    assert clean.explained
    assert {row.verdict for row in averaged_rows(clean)} == {"determined by the data"}
    bent = np.array([1.03, 0.97, 1.03, 0.97, 1.03, 0.97])
    wrong = diagnosed([listed(case, bent)], [], gain=False)
    assert wrong.claim.kind == "other"
    assert not wrong.explained
    assert not wrong.plain_explained
    for line in diagnosis_result(wrong, 3).in_words().constants:
        assert line.determined == "partly"
        assert line.by == "a plate model that does not describe the frequencies"


def test_the_misfit_of_the_plain_model_alone_takes_nothing_from_the_extended_one(misread):
    assert misread.claim.kind == "named"
    assert not misread.plain_explained
    assert misread.explained


def test_an_answer_says_which_errors_of_the_plate_its_intervals_contain(case, clean):
    (said,) = (
        t for t in diagnosis_result(clean, 3).in_words().basis if t.startswith("The intervals contain")
    )
    scale = next(c.probability for c in clean.causes if c.name == "frequency_scale")
    assert said == (
        "The intervals contain no error of thickness, length, width, density or the analyser's frequency "
        "scale, which count as exact; as causes that were weighed they have a probability of "
        f"{significant(scale, 2)} together."
    )
    plate = replace(case.models.specimen.plate, sd={"thickness": 2e-5, "length": 1e-4})
    assert contained_sentence(plate, found=("density",)) == (
        "The intervals contain the uncertainty of thickness (+- 0.02 mm), length (+- 0.1 mm) and density "
        "(what was found); they contain no error of width or the analyser's frequency scale, which count as "
        "exact."
    )


def test_the_prior_that_an_interval_rests_on_is_named_beside_it(clean):
    relied = replace(clean, reliances=(Reliance("E1", "nu12", 0.42), Reliance("nu12", "E1", 0.11)))
    words = diagnosis_result(relied, 3).in_words()
    assert words.constants[0].determined_text.endswith(", with the bounds of nu12")
    assert any(
        t.startswith("The interval of E1 rests on the bounds of nu12 too, ") and t.endswith("42 % wider.")
        for t in words.basis
    )


@pytest.mark.parametrize(
    ("name", "shown"),
    [
        ("sag", ("mm", 1e3)),
        ("skin_thickness", ("um", 1e6)),
        ("sensor_mass", ("g", 1e3)),
        ("residual_stress", ("MPa", 1e-6)),
        ("thickness_deviation", ("%", 100.0)),
        ("loss_tangent", ("", 1.0)),
        ("skew_deg", ("deg", 1.0)),
    ],
)
def test_sizes_are_shown_in_the_units_of_a_workshop(name, shown):
    (parameter,) = (p for effect in CATALOGUE for p in effect.parameters if p.name == name)
    assert parameter.display == shown


def test_probabilities_that_round_to_nought_or_one_are_told_as_bounds():
    assert probability_text(1e-9) == "< 0.001"
    assert probability_text(1 - 1e-9) == "> 0.999"
    assert probability_text(0.5) == "0.50"
    assert probability_text(0.962) == "0.962"
