"""The text, figures and files of a diagnosis, for lists with a known truth."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest
from matplotlib.container import BarContainer, ErrorbarContainer
from matplotlib.patches import Rectangle

from cpam_bayes.answer import Notice, Reliance, Verdict
from cpam_bayes.diagnosis.answers.detectability import Detectable
from cpam_bayes.diagnosis.diagnose import diagnosis_notices
from cpam_bayes.diagnosis.hypotheses import Claim
from cpam_bayes.diagnosis.next_test import Candidate
from cpam_bayes.effects import CATALOGUE, ListChange
from cpam_bayes.parameters import Uniform
from cpam_bayes.questions.diagnose import _at_stated_bound, diagnosis_result
from cpam_bayes.questions.diagnose.claim import checked_effects, claim_sentence
from cpam_bayes.questions.diagnose.document import (
    absorbed_biases,
    answer_constants,
    catalogue_sd,
    detectable_rows,
    detectable_size,
    fit_constants,
    probability_text,
    size_text,
)
from cpam_bayes.render.report import json_text
from tests import diagnosed as known
from tests.diagnosed import CHEAP, DRAWN, MISREAD, aluminium_case, diagnosed, listed
from tests.plate_file import refused

TITLES = {effect.name: effect.title for effect in CATALOGUE}
MASS = next(effect for effect in CATALOGUE if effect.local == "point")


@pytest.fixture(scope="module")
def clean():
    return known.clean()


@pytest.fixture(scope="module")
def misread():
    return known.misread()


@pytest.fixture(scope="module")
def false_peak():
    case = aluminium_case()
    f = case.models.bare.predict(np.array([[69e9, 0.33]])).frequencies[0]
    with_false = np.concatenate((f[:2], [190.0], f[2:5]))
    return diagnosed([listed(case, with_false / f[:6])], ["mode_identity"], gain=False)


@pytest.fixture(scope="module")
def two_plates():
    cases = [listed(aluminium_case(), MISREAD), listed(aluminium_case("plate 8"), np.ones(6), -DRAWN)]
    return diagnosed(cases, ["outlier"], gain=False)


def document(d, **more):
    notices = (Notice("as_written", facts={"text": "mind this"}),)
    return json.loads(json_text(replace(diagnosis_result(d, 3, **more), notices=notices).to_dict()))


def summary(d, **more):
    return diagnosis_result(d, 3, **more).report().summary


def table(d, title, **more):
    sections = diagnosis_result(d, 3, **more).report().sections
    (found,) = (t for s in sections for t in s.tables if t.title.startswith(title))
    return found.rows


def test_the_document_has_a_claim_constants_with_intervals_a_gain_and_residuals_of_one_sign(misread):
    found = document(misread)
    assert (found["plate"], found["seed"], found["warnings"]) == ("plate 7", 3, ["Mind this."])
    assert (found["claim"], found["causes"]) == ("named", ["outlier"])
    assert found["something_wrong"] > found["inclusion"]["outlier"] == found["probability"] > 0.9
    assert found["air_density_kg_m3"] == {"plate 7": None}
    assert "Probability of each cause" in diagnosis_result(misread, 3).summary(verbose=True)
    for constants in (found["constants"], *(found[fit]["constants"] for fit in ("baseline", "extended"))):
        assert set(constants) == {"E1_GPa", "nu12"}
        assert all(constant["q025"] < constant["mean"] < constant["q975"] for constant in constants.values())
    gain, rows = found["gain"], found["baseline"]["frequencies"]
    stated = found["baseline"]["rms_as_stated_percent"]
    assert gain["rms_percent_after"] < gain["rms_percent_before"] == stated > found["baseline"]["rms_percent"]
    assert 0.0 <= gain["stable_share"] <= 1.0
    assert gain["held_out_hypotheses"] == misread.gain.n_hypotheses >= 2
    assert [row["kind"] for row in rows] == ["bending"] * 6
    for row in rows:
        off = row["predicted_hz"] - row["measured_hz"]
        sd = np.hypot(row["noise_sd_hz"], row["predicted_sd_hz"])
        assert row["residual_percent"] == pytest.approx(100 * off / row["measured_hz"], abs=1e-9)
        assert row["standardised"] == pytest.approx(off / sd)


def test_every_cause_has_a_probability_and_a_detection_limit(clean, misread):
    for d in (clean, misread):
        found = document(d)
        names = [h["cause"] for h in found["hypotheses"]]
        tested = [name for name in names if name not in ("none", "other")]
        assert len(set(names)) == len(names) == len(tested) + 2
        assert [entry["cause"] for entry in found["detectable"]] == tested
        assert found["tested"] == {"causes": tested, "hypotheses": len(d.weighed.tested)}
        ranges = [h["probability_range"].values() for h in found["hypotheses"]]
        for probabilities in ([h["probability"] for h in found["hypotheses"]], *zip(*ranges, strict=True)):
            assert sum(probabilities) == pytest.approx(1.0, abs=1e-9)
    # the constants imitate a wrong clock
    (told,) = (entry for entry in document(clean)["detectable"] if entry["cause"] == "frequency_scale")
    assert (told["smallest"], told["unit"], told["probability_of_claim"]) == (None, "%", 0.0)


def test_a_misread_frequency_is_named_with_its_size_its_check_and_what_it_depends_on(misread):
    outlier = next(h for h in document(misread)["hypotheses"] if h["cause"] == "outlier")
    size = outlier["parameters"]["misreading"]
    assert (outlier["variant"], size["unit"]) == ("frequency 3", "%")
    assert size["mean"] == pytest.approx(5.0, abs=3 * size["sd"])
    hz, said = misread.cases[0].measurement.frequencies[2], claim_sentence(misread)
    assert f"isread frequency {hz:g} Hz" in said
    assert f"{size['mean']:.2f}" in said
    assert probability_text(misread.claim.probability) in said
    (effect,) = misread.causes[0].hypothesis.records
    assert summary(misread).next_step.lower() == effect.check.lower()
    two = replace(misread, claim=Claim("class", ("outlier", "viscoelastic"), 0.99))
    assert [row[0] for row in table(two, "Laboratory checks")] == [TITLES["outlier"], TITLES["viscoelastic"]]
    # a claim that depends on assumed sizes is flagged
    assert (misread.sensitivity.claim_stands, summary(misread).warnings) == (True, ())
    claims = (Claim("none", (), 0.6), Claim("class", ("outlier", "warp"), 0.95))
    other = replace(misread.sensitivity, claim_stands=False, claims=claims)
    (warning,) = summary(replace(misread, sensitivity=other)).warnings
    assert all(TITLES[name] in warning for name in ("outlier", "warp"))


def test_constants_are_those_of_all_hypotheses_and_determined_where_noise_explains_the_misfit(clean, misread):
    found = document(misread)  # the list was made with 69 GPa; the misread frequency biases the plain model
    plain, extended, e1 = (of["constants"]["E1_GPa"] for of in (found["baseline"], found["extended"], found))
    assert all(one["q025"] < 69.0 < one["q975"] for one in (extended, e1))
    assert abs(plain["mean"] - 69.0) > abs(extended["mean"] - 69.0)
    assert found["baseline"]["predictive_p"] < 1e-6 < 0.01 < found["extended"]["predictive_p"]
    assert document(clean)["baseline"]["predictive_p"] > 0.05
    for d in (clean, misread):
        assert document(d)["constants"] == document(d)["averaged"]
        for constant in answer_constants(d):
            assert (constant.value, constant.sd, *constant.interval) == d.averaged[constant.name]
    frame = diagnosis_result(misread, 3).to_dataframe("constants")
    assert frame["mean"].tolist() == [c["mean"] for c in found["constants"].values()]
    bent = np.array(3 * [1.0, -1.0])  # the misfit of the plain model alone takes nothing from the answer
    wrong = diagnosed([listed(aluminium_case(), 1.0 + 0.03 * bent)], [], gain=False)
    for d, claim, plain_explained, verdict in (
        (clean, "none", True, Verdict.DATA),
        (misread, "named", False, Verdict.DATA),
        (wrong, "other", False, Verdict.MISFIT),
    ):
        assert (d.claim.kind, d.plain_explained, d.explained) == (claim, plain_explained, d is not wrong)
        assert {c.verdict for c in answer_constants(d)} == {verdict}
    assert {c.verdict for c in fit_constants(misread, misread.baseline)} == {Verdict.MISFIT}
    (fit,) = (line for line in summary(wrong).lines if "Fit" in line)
    assert "stated repeatability" in fit
    case = listed(aluminium_case(), 1.0 + 0.07 * bent)  # without stated noise a misfit is no estimate of it
    unstated = replace(case, measurement=replace(case.measurement, relative_std=None))
    open_ = diagnosed([unstated], [], gain=False)
    assert open_.claim.kind == "other"
    (fit,) = (line for line in summary(open_).lines if "Fit" in line)
    said = re.fullmatch(r"Fit ([\d.]+) %; ([\d.]+) % remains unexplained.", fit)
    assert 5.0 < float(said[2]) < float(said[1]) < 7.5
    upper = clean.cases[0].models.parameters["E1"].prior.upper
    pushed = {**clean.averaged, "E1": (0.98 * upper, 0.01 * upper, 0.96 * upper, 0.9999 * upper)}
    assert [c.bound for c in answer_constants(replace(clean, averaged=pushed))] == ["upper", None]
    # the prior that an interval depends on is named
    relied = replace(clean, reliances=(Reliance("E1", "nu12", 0.42), Reliance("nu12", "E1", 0.11)))
    assert [c.rests_on for c in answer_constants(relied)] == [("nu12",), ("E1",)]
    said = [row[0] for row in table(relied, "What the intervals depend on")]
    assert any("E1" in text and "nu12" in text and "42 %" in text for text in said)


def test_a_false_peak_belongs_to_no_mode_and_later_ones_to_the_mode_before(false_peak):
    rows = document(false_peak)["extended"]["frequencies"]
    assert [row["kind"] for row in rows] == ["bending", "bending", None, *3 * ["bending"]]
    assert (rows[2]["predicted_hz"], rows[2]["residual_percent"]) == (None, None)
    assert all(abs(row["residual_percent"]) < 1.0 for row in rows if row["predicted_hz"])
    _, _, third, fourth, *_ = table(false_peak, "Fit of each mode")
    assert fourth[-1] == "was mode 4, (2,1)"
    assert "no mode" in third
    assert "190.2 Hz is not a mode" in claim_sentence(false_peak)


def test_several_plates_have_one_object_each_and_share_their_constants(two_plates):
    found = document(two_plates)
    assert [p["plate"] for p in found["plates"]] == ["plate 7", "plate 8"]
    assert "plate" not in found
    for fit in (found["baseline"], found["extended"]):
        plates = fit["plates"]
        assert [len(plate["frequencies"]) for plate in plates] == [6, 6]
        square = np.mean([plate["rms_percent"] ** 2 for plate in plates])
        assert np.sqrt(square) == pytest.approx(fit["rms_percent"], rel=1e-9)
        # a plate's own constant is the shared one within the scatter from plate to plate
        shared = fit["constants"]["E1_GPa"]["mean"]
        assert all(abs(p["constants"]["E1_GPa"]["mean"] / shared - 1) < 0.08 for p in plates)
    assert found["material_scatter"] == 0.02
    assert [h["plates"] for h in found["hypotheses"] if h["cause"] == "outlier"] == [["plate 7"]]
    assert "of plate 7" in found["sentence"]


def test_hidden_errors_and_priors_of_families_causes_and_sizes_are_told(clean):
    # f scales with the root of E: a clock 1 % too fast is 2 % of E, 0 of nu12
    (hidden,) = clean.hidden_causes
    assert hidden.name == "frequency_scale"
    _, unit, per_unit = absorbed_biases(clean, hidden)
    assert (unit, catalogue_sd(hidden)) == ("%", 2.0)
    assert per_unit["E1_GPa"] == pytest.approx(2.0, rel=0.02)
    assert per_unit["nu12"] == pytest.approx(0.0, abs=0.02)
    (entry,) = document(clean)["absorbed"]
    assert entry["bias_percent"]["E1_GPa"] == pytest.approx(entry["at"] * per_unit["E1_GPa"])
    ((title, size, *_),) = table(clean, "Errors absorbed by the constants")
    assert (title, size) == (TITLES["frequency_scale"], "2 %")
    priors = document(clean)["priors"]  # a set has no family among the priors
    assert (priors["none"], priors["other"]) == (0.5, 0.05)
    assert priors["families"]["size"]["frequency_scale"] > 0
    size = priors["effects"]["frequency_scale"]["frequency_deviation"]
    assert (size["kind"], size["scale"], size["unit"], size["gross"]) == ("Student-t", 2.0, "%", None)
    assert priors["sets_tested"] == 0.0
    tested = clean.weighed.tested
    scale = next(t for t in tested if t.hypothesis.cause == "frequency_scale")
    taper = next(effect for effect in CATALOGUE if effect.name == "taper_x")
    of_taper = {"cause": "taper_x", "family": "shape", "parameters": taper.parameters, "prior": 0.01}
    gross = replace(scale, hypothesis=replace(scale.hypothesis, **of_taper))
    both = replace(gross, hypothesis=replace(gross.hypothesis, cause="a + b", family="set", prior=0.002))
    weighed = replace(clean.weighed, tested=(*tested, gross, both))
    priors = document(replace(clean, weighed=weighed))["priors"]
    assert priors["sets_tested"] == 0.002
    assert "a + b" not in {cause for causes in priors["families"].values() for cause in causes}
    assert priors["effects"]["taper_x"]["taper_x"]["gross"]["fraction"] == 0.1


def test_of_a_list_with_nothing_wrong_nothing_is_extended_and_the_intervals_are_explained(clean):
    found, said, result = document(clean), summary(clean), diagnosis_result(clean, 3)
    assert said.headline == claim_sentence(clean)
    begins = r"No evidence of an error \(probability of one ([\d.]+), Bayes factor ([\d.]+)\)"
    told = re.match(begins, said.headline)
    assert float(told[1]) == pytest.approx(1.0 - clean.weighed.by_cause()["none"], abs=0.006)
    assert float(told[2]) == pytest.approx(clean.bayes_factor, rel=0.06)
    assert (found["claim"], found["causes"], found["extended"], found["gain"]) == ("none", [], None, None)
    assert not {s.title for s in result.report().sections} & {"What was found", "How it was noticed"}
    (contained,) = (text for text in said.lines if "intervals contain" in text)
    numbers = ("noise", "thickness", "length", "width", "density", "frequency scale")
    assert all(number in contained for number in numbers)
    assert "Not contained" not in contained
    # but not if the file contradicts itself
    facts = {"gauged": (3.1e-3, 2e-5), "by_mass": (2.5e-3, 2.5e-5), "apart": 19.6, "taken": (2.85e-3, 3.1e-4)}
    contradicted = replace(result, notices=(Notice("thicknesses_apart", "slip", facts),))
    said = contradicted.report().summary
    assert said.headline.startswith("From the frequencies alone: no evidence of an error")
    assert said.next_step.startswith("gauge and weigh the plate again")
    assert contradicted.to_dict()["sentence"] == said.headline


def test_a_constant_is_at_a_bound_of_the_file_not_at_the_end_of_its_prior(clean):
    (specimen,) = (case.models.specimen for case in clean.cases)
    prior = next(p.prior for p in specimen.unknowns.parameters if p.name == "E1")
    for end, stated in ((prior.upper, True), (0.99 * prior.upper, False)):
        at_end = replace(answer_constants(clean)[0], bound="upper", prior=Uniform(prior.lower, end))
        assert _at_stated_bound(at_end, [specimen]) is stated


def with_causes(d, causes, claim):
    probability = {c.name: c.probability for c in causes}
    ranges = tuple({**probability, **before} for before in d.sensitivity.probabilities)
    sensitivity = replace(d.sensitivity, probabilities=ranges)
    return replace(d, causes=tuple(causes), claim=claim, sensitivity=sensitivity)


def test_no_first_screen_has_keys_of_causes_whatever_is_claimed(clean, misread, false_peak, two_plates):
    undecided = Claim("undecided", ("viscoelastic",), 0.4)
    of_two = Claim("class", ("viscoelastic", "frequency_scale"), 0.95)
    claimed = [replace(misread, claim=claim) for claim in (undecided, of_two, Claim("other", (), 0.97))]
    for d in (clean, false_peak, two_plates, replace(clean, claim=undecided), *claimed):
        lines = [line for line in diagnosis_result(d, 3).summary().splitlines() if line.strip()]
        assert len(lines) <= 15, "with title and table"
        assert len(" ".join(lines).split()) <= 140, "with the words of title and table"
        assert not [e.name for e in CATALOGUE if "_" in e.name and e.name in " ".join(lines)]


def test_every_claim_has_its_own_sentence_with_sizes_and_what_acts_beside_it(clean, misread, monkeypatch):
    def said(d, kind, causes, p):
        return claim_sentence(replace(d, claim=Claim(kind, causes, p)))

    assert f"{clean.bayes_factor:.2g}" in claim_sentence(clean)
    class_ = said(clean, "class", ("thickness", "density"), 0.95)
    assert all(part in class_ for part in (TITLES["thickness"], TITLES["density"], "0.950"))
    assert "no known error explains" in said(clean, "other", (), 0.97)
    # undecided is of two kinds: open is either the error, or whether there is one
    what = said(misread, "undecided", ("outlier",), 0.4)
    assert what.startswith(f"Something is wrong ({probability_text(misread.something_wrong)})")
    assert TITLES["outlier"] in what
    weighed = replace(misread.weighed, unaccounted=0.5)
    with monkeypatch.context() as of:
        of.setattr(type(misread), "inclusion", {"outlier": 0.97, "warp": 0.02})
        what = said(replace(misread, weighed=weighed), "undecided", ("outlier",), 0.97)
    assert what.startswith("Misread frequency (0.970 of what was tested); what else is wrong is open (plate ")
    assert "too weak to exclude" in said(clean, "undecided", ("viscoelastic",), 0.4)
    for inclusion, told in (  # if no single cause explains it, the probable part is named
        ({"sensor_mass": 0.85, "support": 0.1}, "explains by itself (0.970); part of it: added mass 0.85."),
        ({"sensor_mass": 0.4}, "explains (probability 0.970)."),
    ):
        monkeypatch.setattr(type(misread), "inclusion", inclusion)
        assert said(misread, "other", (), 0.97) == f"Something is wrong that no known error {told}"
    # a probability that rounds to 0 or 1 is shown as a bound
    texts = {1e-9: "< 0.001", 1 - 1e-9: "> 0.999", 0.5: "0.50", 0.962: "0.962"}
    assert {p: probability_text(p) for p in texts} == texts
    monkeypatch.undo()
    alone = next(c for c in clean.causes if c.name == "viscoelastic")  # two errors with their sizes
    name = "skew + viscoelastic"
    both = replace(alone, name=name, hypothesis=replace(alone.hypothesis, cause=name))
    claim = Claim("pair", ("skew", "viscoelastic"), 0.93)
    said = claim_sentence(with_causes(clean, (*clean.causes, both), claim))
    assert said.startswith("Two errors at once")
    assert all(part in said for part in (size_text(alone), "0.930"))
    beside = {"warp + skew": 0.5, "warp + damage": 0.4}  # further causes beside the claim
    two = tuple(replace(alone, name=name, probability=p) for name, p in beside.items())
    others = (replace(c, probability=0.0) for c in clean.causes if c.name != "warp")
    causes = (*others, replace(alone, name="warp", probability=0.05))
    found = with_causes(clean, (*causes, *two), Claim("named", ("warp",), 0.95))
    assert found.beside == {"skew": 0.5, "damage": 0.4}
    together = "together with another error (probability 0.950)."
    assert claim_sentence(found) == f"{TITLES['warp'].capitalize()}, {together}"
    assert next(iter(found.inclusion.items())) == ("warp", pytest.approx(0.95))
    (line,) = (text for text in summary(found).lines if "Perhaps also" in text)
    assert TITLES["skew"] in line
    likely = tuple(replace(c, probability=0.6) if c.name == "warp" else c for c in found.causes)
    assert f": {size_text(alone)} if alone." in claim_sentence(replace(found, causes=likely))
    faint = replace(found, causes=(*causes, replace(two[0], probability=0.01)))
    assert not any("Perhaps also" in text for text in summary(faint).lines)
    assert replace(found, claim=Claim("class", ("warp", "skew"), 0.95)).beside == {"damage": 0.4}


def test_what_is_said_turns_at_stated_limits(clean, misread):
    none, cause = (next(c for c in clean.causes if c.name == name) for name in ("none", "viscoelastic"))
    open_ = Claim("undecided", ("viscoelastic",), 0.4)  # a Bayes factor of three; none has a prior of 1/2
    for factor, begun in ((2.9, "This test is too weak to exclude an error"), (3.1, "Perhaps something")):
        found = with_causes(clean, (replace(none, probability=1.0 / (1.0 + factor)),), open_)
        assert claim_sentence(found).startswith(begun)
    for visible, count in ((0.29, 1), (0.31, 0)):  # hidden if less than three tenths are visible
        assert len(replace(clean, causes=(replace(cause, visible=visible),)).hidden_causes) == count
    for p, count in ((0.09, 0), (0.11, 1)):  # and is to be checked from one in ten if nothing is claimed
        found = with_causes(clean, (replace(cause, probability=p),), Claim("undecided", (), p))
        assert len(checked_effects(found)) == count
    for stable, count in ((0.79, 1), (0.81, 0)):  # a claim that one frequency in five overturns is flagged
        found = replace(misread, gain=replace(misread.gain, stable=stable))
        assert sum(n.code == "single_frequencies" for n in diagnosis_notices(found)) == count


def test_detection_limits_are_told_and_so_is_what_cannot_be_seen(clean, misread):
    parameter = misread.causes[0].hypothesis.parameters[0]
    seen, unseen = Detectable("outlier", parameter, 0.0123, 0.96), Detectable("air", parameter, None, 0.3)
    d = replace(clean, detectable=(seen, unseen, Detectable("mode_identity", None, None, None)))
    ((title, size, *_),) = table(d, "Detection limits")
    assert (title, size) == (TITLES["outlier"], "1.2 %")
    assert [row[0] for row in table(d, "Cannot be seen")] == [TITLES["air"], TITLES["mode_identity"]]
    own = {"cause": MASS.name, "effects": (MASS,), "parameters": MASS.parameters}
    parameters = {p.name: (0.5, 0.1, p.unit) for p in MASS.parameters}
    of_mass = replace(clean.causes[0].hypothesis, **own)
    added = replace(clean.causes[1], name=MASS.name, hypothesis=of_mass, parameters=parameters)
    with_mass = with_causes(clean, (*clean.causes, added), clean.claim)
    for smallest, said in (
        (0.0039, "A forgotten mass of 3.9 g or more would have been seen."),
        (None, "A forgotten mass would not have been seen."),
    ):
        entry = Detectable(MASS.name, MASS.parameters[0], smallest, 0.95)
        assert said in summary(replace(with_mass, detectable=(entry,))).lines


@pytest.mark.parametrize(
    ("chances", "best"), [((0.2, 0.31), "load"), ((0.01, 0.29), "load"), ((0.06,), "clamp")]
)
def test_the_test_that_decides_is_the_next_step_and_another_one_the_last(clean, chances, best):
    tests = tuple(
        Candidate(name, f"{name} it", 1.42 - i, 2.1, chance)
        for i, (name, chance) in enumerate(zip(("clamp", "load"), chances, strict=False))
    )
    undecided = replace(clean, claim=Claim("undecided", ("viscoelastic",), 0.4))
    assert (best in summary(undecided, candidates=tests).next_step) == (max(chances) > 0.3)
    if max(chances) < 0.3:
        assert best in table(undecided, "Further steps", candidates=tests)[-1][0]
    told = document(clean, candidates=tests)["next_measurement"][0]  # each is shown with its information
    assert (told["name"], told["information_nats"], told["possible_nats"]) == ("clamp", 1.42, 2.1)
    rows = table(clean, "Further tests", candidates=tests)
    assert ("clamp it", "1.42", "2.10", f"{100 * chances[0]:.0f} %") in rows


def found(d, effect, values, *more):
    """A diagnosis that claims an effect with others beside it, all parameters having these values to 2 %."""
    parameters = tuple(p for e in (effect, *more) for p in e.parameters)
    own = {"cause": effect.name, "effects": (effect, *more), "parameters": parameters}
    hypothesis = replace(d.causes[0].hypothesis, unmodelled=(), listed=ListChange(), **own)
    moments = {p.name: (v, 0.02 * v, "") for p, v in zip(parameters, values, strict=True)}
    named = {"name": effect.name, "variant": effect.variant}
    cause = replace(d.causes[0], parameters=moments, hypothesis=hypothesis, **named)
    return with_causes(d, (cause, *d.causes[1:]), Claim("named", (effect.name,), 0.996))


def drawn(d):
    top = diagnosis_result(d, 0).plot().subfigs[0].axes[0]
    squares = [patch for patch in top.patches if isinstance(patch, Rectangle)]
    return [line for line in top.lines if line.get_marker() == "o"], squares


def rounded(points):
    return {(round(x), round(y)) for x, y in points}


def test_what_was_found_is_told_and_drawn_where_it_was_with_its_images(misread):
    case = misread.cases[0]
    plate, specimen = case.models.specimen.plate, case.models.specimen
    a, b = 1e3 * plate.length, 1e3 * plate.width
    x, y = 0.8 * a, 0.6 * b
    size, *where, gyration = MASS.parameters
    where = [replace(p, prior=replace(p.prior, lower=0.5)) for p in where]
    effect = replace(MASS, parameters=(size, *where, gyration))
    d = found(misread, effect, (0.005, 0.8, 0.6, 0.006))
    places = [(u, v) for u in (x, a - x) for v in (y, b - y)]
    near = "{}, {}, {} or {}".format(*(f"({u:.0f}, {v:.0f})" for u, v in places))
    assert f"5.00 +- 0.10 g near {near} mm, +- {max(0.02 * x, 0.02 * y):.0f} mm" in claim_sentence(d)
    (told,) = (h["places_mm"] for h in document(d)["hypotheses"] if h["cause"] == "sensor_mass")
    assert told == {"sensor_mass": [pytest.approx(list(place)) for place in places]}
    assert [drawing.name for drawing in diagnosis_result(d, 0).drawings()][:2] == ["plate", "residuals"]
    dots, _ = drawn(d)
    assert rounded(line.get_xydata()[0] for line in dots) == rounded(places)
    # two masses, each at its place
    both = found(misread, effect, (0.005, 0.8, 0.6, 0.006, 0.002, 0.7, 0.9, 0.004), effect.again())
    own, other = claim_sentence(both).split(";")
    assert f"near ({x:.0f}, {y:.0f})," in own
    assert f"2.000 +- 0.040 g near ({0.7 * a:.0f}, {0.9 * b:.0f})," in other
    dots, _ = drawn(both)
    filled = [pytest.approx(tuple(line.get_xydata()[0])) for line in dots if line.get_mfc() != "none"]
    assert filled == [(x, y), (0.7 * a, 0.9 * b)]
    square = replace(specimen, plate=replace(plate, length=plate.width))  # a square of metal has eight
    facts = replace(case.models.facts, length=plate.width)
    models = replace(case.models, specimen=square, facts=facts)
    said = claim_sentence(replace(d, cases=(replace(case, models=models),)))
    assert "mm or one of its 7 images, +- " in said
    (outline,) = (e for e in CATALOGUE if e.drawn == "corner")  # a missing corner is drawn too
    d = found(misread, outline, (0.002,))
    said = claim_sentence(d)
    assert "Corner missing, 0.2000 +- 0.0040 % of the area (at x = length, y = width" in said
    assert "shorter side, or a place equal by symmetry)" in said
    plate = d.cases[0].models.specimen.plate
    a, b = 1e3 * plate.length, 1e3 * plate.width
    side = 0.06 * min(a, b)
    _, squares = drawn(d)
    found_at = [p.get_xy() for p in squares if p.get_width() == pytest.approx(side)]
    assert found_at[0] == pytest.approx((a - side, b - side))
    assert rounded(found_at) == rounded((x, y) for x in (0.0, a - side) for y in (0.0, b - side))


def test_fits_constants_causes_limits_and_signatures_are_drawn(misread):
    figures = diagnosis_result(misread, 0).figures()
    shapes = figures["residuals"].subfigs[0].axes
    assert len(shapes) == 7, "residuals and a shape for each of six modes"
    bars = [c for c in shapes[0].containers if isinstance(c, BarContainer)]
    for fit, own in zip((misread.baseline, misread.extended), bars, strict=True):
        expected = 100.0 * (fit.predicted / fit.measured - 1.0)
        assert [bar.get_height() for bar in own] == pytest.approx(expected)
    (whiskers, _) = (c for c in shapes[0].containers if isinstance(c, ErrorbarContainer))
    fit = misread.baseline
    ends = np.array(whiskers[2][0].get_segments())[:, :, 1]
    two_sd = 200.0 * np.hypot(fit.sigma, fit.predicted_sd) / fit.measured
    assert 0.5 * np.ptp(ends, axis=1) == pytest.approx(two_sd)
    panels = figures["constants"].axes
    assert [axes.get_title() for axes in panels] == ["E1, GPa", "nu12"]
    before_after = [bars.lines[0].get_ydata()[0] for bars in panels[0].containers]
    assert before_after == pytest.approx([fit.constants["E1"][0] / 1e9, misread.averaged["E1"][0] / 1e9])
    (reference,) = [line for line in panels[0].lines if line.get_label() == "reference"]
    assert list(reference.get_ydata()) == [69.0, 69.0]
    axes = figures["causes"].axes[0]
    widths = sorted(bar.get_width() for bar in axes.containers[0])
    assert widths == pytest.approx(sorted(cause.probability for cause in misread.causes))
    (needed,) = (line for line in axes.lines if line.get_label() == "needed for a claim")
    labels = [text.get_text() for text in axes.get_yticklabels()]
    claims = dict(zip(labels, needed.get_xdata(), strict=True))
    assert (claims.pop("nothing wrong"), set(claims.values())) == (0.5, {0.9})
    assert TITLES["outlier"] in claims
    # no signature of a hidden cause
    signatures = {text.get_text() for text in figures["signatures"].axes[0].get_xticklabels()}
    assert signatures == {TITLES["outlier"], TITLES["viscoelastic"]}
    axes = figures["detectable"].axes[0]  # detection limits are points at their sizes
    labels = [text.get_text() for text in axes.get_yticklabels()]
    rows = {row.title: row for row in detectable_rows(misread)}
    assert set(labels) == set(rows)
    points = {
        float(line.get_ydata()[0]): line.get_xdata()[0] for line in axes.lines if line.get_marker() == "o"
    }
    shown = {y: rows[label].in_sd for y, label in enumerate(labels) if rows[label].in_sd is not None}
    assert points == pytest.approx(shown)
    sizes = [detectable_size(rows[label]) for label in labels]
    assert [text.get_text() for text in axes.texts] == sizes
    assert rows[TITLES["frequency_scale"]].smallest is None, "a clock that is off is not seen"


def test_plates_that_are_not_several_of_one_material_are_refused(run):
    refused(run("diagnose", "A1", "A1"), "received A1 twice")
    refused(run("diagnose", "A1", "C1"), "material carbon/epoxy, while A1 has aluminium")


@pytest.mark.usefixtures("few_causes")
def test_the_prior_of_none_is_an_option_and_the_others_keep_their_proportions(run, plate_file):
    path = plate_file(("[measurement]", "[environment]\nair_density_kg_m3 = 1.2\n\n[measurement]"))
    asked = ("diagnose", path, "--json", "--next", "never")
    _, out, err = run(*asked)
    assert re.search(r"\d of \d+ hypotheses", err)
    as_is, other = (json.loads(o) for o in (out, run(*asked, "--quiet", "--prior-none", "0.9")[1]))
    for document, prior in ((as_is, 0.5), (other, 0.9)):
        assert document["priors"]["none"] == prior
        assert {h["cause"] for h in document["hypotheses"]} == CHEAP
        assert document["next_measurement"] == []
        assert document["air_density_kg_m3"] == {"plate 7": 1.2}  # air in the file is part of the model
        assert 0.0 < document["basis_error"] < 1e-4
    before, after = ({h["cause"]: h["prior"] for h in d["hypotheses"]} for d in (as_is, other))
    ratios = [after[name] / before[name] for name in before if name != "none"]
    assert ratios == pytest.approx([0.2] * len(ratios))
    # odds follow the priors, except for hypotheses for which a first look then suffices: 0.1 nats
    odds = [next(h["probability"] for h in d["hypotheses"] if h["cause"] == "none") for d in (as_is, other)]
    assert odds[1] / (1 - odds[1]) == pytest.approx(9 * odds[0] / (1 - odds[0]), rel=0.15)
