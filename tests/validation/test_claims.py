"""The benchmark of claims: lists with their stated content, scores as a user reads them, other methods."""

import json
import subprocess
import tomllib
from dataclasses import asdict, replace
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import cpam_bayes as cb
from cpam_bayes.effects import CATALOGUE
from cpam_bayes.questions.diagnose import diagnosis_result
from cpam_bayes.render.report import json_text
from tests.diagnosed import misread
from tests.test_studies import PROJECT, saved, script
from validation import brick_lists, fingerprints, own_method
from validation.claims import answering, references, scoring, seal, sets
from validation.independent import drawn, lists
from validation.independent.true_plate import FLAWS
from validation.reporting import save_results, saved_results, with_saved


def test_saved_results_come_back_and_cases_that_were_not_run_again_stay_in_order(tmp_path: Path) -> None:
    path = tmp_path / "08.json"
    cases = [{"case": "D3", "x": 1}, {"case": "C1", "x": 1}, {"case": "C1", "x": 2}]
    cost = [{"case": "D1", "s": 4}, {"case": "no longer a case", "s": 5}]
    save_results(path, {"seeds": 3, "cases": cases, "cost": cost})
    new = {"seeds": 20, "cases": [{"case": "D1", "x": 7}, {"case": "C1", "x": 8}], "cost": []}
    kept = [{"case": "C1", "x": 8}, {"case": "D1", "x": 7}, {"case": "D3", "x": 1}]
    both = with_saved(new, path, ("C1", "D1", "D3"))
    assert both == {"seeds": 20, "cases": kept, "cost": [{"case": "D1", "s": 4}]}
    assert new["cases"] == [{"case": "D1", "x": 7}, {"case": "C1", "x": 8}], "left as they are"
    save_results(path, {"groups": [{"plates": ["C1", "C2"]}, {"plates": ["C1"], "p": 1}]})
    groups = {"groups": [{"plates": ["C1"], "p": 2}]}
    both = with_saved(groups, path, [("C1",), ("C1", "C2")], lambda g: tuple(g["plates"]))
    assert both == {"groups": [{"plates": ["C1"], "p": 2}, {"plates": ["C1", "C2"]}]}
    # results are read back unchanged, and NaN is refused before anything is lost
    path = tmp_path / "results" / "01.json"
    assert saved_results(path) == {}
    results = {"quick": False, "cases": [{"case": "C1", "rms": 1.5}]}
    save_results(path, results)
    with pytest.raises(ValueError, match="JSON"):
        save_results(path, {"cases": [{"case": "C1", "rms": np.nan}]})
    assert saved_results(path) == results


PLATE = lists.PLATES[3]
DATA, STUDY = PROJECT / "studies" / "data" / "claims", script("studies", "15_claims")


@pytest.fixture(scope="module")
def tapered() -> tuple[str, lists.Truth]:
    return lists.single(PLATE, "taper_x", 16.0, np.random.default_rng(3), stated=False)


def test_a_list_is_a_plate_file_that_says_what_the_truth_says(tapered: tuple[str, lists.Truth]) -> None:
    assert tapered[1].extra["signal_to_noise"] == pytest.approx(16.0, rel=0.1)  # found on a coarse mesh
    read = cb.read_plate(tomllib.loads(tapered[0]))
    assert read.measurement.relative_std is None
    assert set(read.material.sd) == set(tapered[1].constants)
    np.testing.assert_allclose(read.measurement.frequencies, tapered[1].true_hz, rtol=0.011)  # noise, 0.1 Hz


def test_a_weighed_plate_states_what_it_weighs_and_a_wrong_density_is_a_wrong_weight() -> None:
    plates = (drawn.plate(np.random.default_rng(k), lambda plate: True) for k in range(40))
    own = next(p for p in plates if p.weighed and set(p.plate.edges) == {"F"})
    thin, made = lists.single(own, "thickness", None, np.random.default_rng(1), size=-0.2)
    heavy, _ = lists.single(own, "density", None, np.random.default_rng(1), size=0.3)
    light, _ = lists.listed(own, own.plate, "clean", {}, np.random.default_rng(1))
    grams = [tomllib.loads(text)["plate"]["mass_g"] for text in (thin, heavy, light)]
    assert "density" not in thin
    # a thickness of 0.8 with 1 % for the gauge, 1 % for the density, 0.2 % for the balance
    assert grams[0] == pytest.approx(0.8e3 * own.plate.total_mass, rel=0.05)
    assert grams[1] == pytest.approx(grams[2], rel=0.06)
    assert made.causes == ("thickness",)


def test_every_cause_that_elements_can_have_is_drawn_and_every_list_has_a_name_of_its_own() -> None:
    assert len(sets.PLANS) == len([*drawn.plans(), *brick_lists.plans()])
    hidden = {name.split("-")[1] for name in sets.PLANS if name.startswith("strength-")}
    assert hidden == set(FLAWS)
    elsewhere = {"air", "layup", "edge_mass", "soft_support", "swapped_sides"}  # in test_hidden_effects.py
    of_list = {"mode_identity", "outlier", "material"}
    assert {e.name for e in CATALOGUE} - elsewhere - of_list <= hidden
    assert {scoring.GROUPS[name.split("-")[0]] for name in sets.PLANS} == set(scoring.GROUPS.values())


def test_names_of_one_physical_thing_are_few_and_symmetric() -> None:
    clamped, free = PLATE.plate, replace(PLATE.plate, edges="FFFF")
    for plate, causes, same in (
        (clamped, ["length"], ("clamp_length",)),
        (clamped, ["clamp_length"], ("length",)),
        (clamped, ["clamp_rotation"], ("soft_clamp",)),
        (clamped, ["clamp_rotation", "taper_y"], ("soft_clamp",)),
        (clamped, ["warp"], ()),
        (free, ["length"], ()),  # it has no clamp
    ):
        assert lists.same_thing(PLATE, plate, {cause: (0.01, {}) for cause in causes}) == same


def truth(*causes: str, accepted: tuple[str, ...] = ()) -> dict[str, Any]:
    made = lists.Truth("one", "T4", causes, accepted, {}, {}, 8.0, {"E1": 40e9}, (), True, True)
    return json.loads(json.dumps(asdict(made)))


def answer(claim: str, *causes: str) -> dict[str, Any]:
    fit = {"E1_GPa": {"mean": 40.0, "sd": 1.0, "q025": 38.0, "q975": 42.0}}
    return {"claim": claim, "causes": list(causes), "probability": 0.95, "constants": fit, "baseline": fit}


@pytest.mark.parametrize(
    ("hidden", "answered", "category", "right"),
    [
        (truth("warp"), answer("named", "warp"), scoring.RIGHT, True),
        (truth("warp"), answer("named", "skew"), scoring.WRONG, False),
        (truth("warp"), answer("class", "skew", "warp"), scoring.RIGHT, True),
        (truth("warp"), answer("pair", "skew", "warp"), scoring.WRONG, False),
        (truth("warp"), answer("other"), scoring.OTHER, False),
        (truth("warp"), answer("none"), scoring.MISSED, False),
        (truth("warp"), answer("undecided", "warp"), scoring.UNDECIDED, False),
        (truth("warp", "skew"), answer("pair", "skew", "warp"), scoring.RIGHT, True),
        (truth("warp", "skew"), answer("named", "skew"), scoring.RIGHT, True),
        (truth("warp", "skew"), answer("pair", "skew", "damage"), scoring.WRONG, False),
        (truth(), answer("none"), scoring.NONE, True),
        (truth(), answer("named", "warp"), scoring.WRONG, False),
        (truth(), answer("other"), scoring.WRONG, False),
        (truth("other"), answer("other"), scoring.OTHER, True),
        (truth("other"), answer("class", "warp", "skew"), scoring.WRONG, False),
        (truth("length", accepted=("clamp_length",)), answer("named", "clamp_length"), scoring.RIGHT, True),
        (truth("soft_clamp"), answer("pair", "clamp_rotation", "clamp_translation"), scoring.RIGHT, True),
        (truth("warp"), {"error": "no"}, scoring.FAILED, False),
    ],
)
def test_a_claim_is_counted_as_a_user_reads_it(hidden, answered, category: str, right: bool) -> None:
    found = scoring.score(hidden, answered)
    assert (found["category"], found["right"]) == (category, right)


def test_saved_results_are_those_of_the_saved_answers() -> None:
    """Scores, figures, intervals, limits, thresholds and all else; pages agree with the results."""
    rounded = partial(json.loads, parse_float=lambda digits: f"{float(digits):.9g}")
    assert rounded(json.dumps(STUDY.run(False))) == rounded(json.dumps(saved("15_claims")))


def test_states_of_the_code_stand_in_the_order_of_their_answers() -> None:
    entries = [{"id": f"prior-{k}", "file": "", "truth": truth()} for k in range(3)]
    commits = {"prior-2": "b", "prior-1": "b", "prior-0": "a"}
    answers = {name: answer("none") | {"commit": commit} for name, commit in commits.items()}
    engines = scoring.by_engine(scoring.scored(entries, answers))
    assert [(e["commit"], e["lists"]) for e in engines] == [("b", 2), ("a", 1)]


FILE = "[plate]\nlength_mm = 200\nwidth_mm = 100\nthickness_mm = 5\n{}"
DENSE, WEIGHED = FILE.format("density_kg_m3 = 2000"), FILE.format("mass_g = 400")


@pytest.mark.parametrize(
    ("cause", "size", "aux", "unit", "above"),
    [
        ("taper_x", -0.05, {}, "%", {4.9: True, 5.1: False}),
        ("taper_x", 0.05, {}, "%", {None: False}),
        ("warp", 1e-3, {}, "mm", {0.99: True, 1.01: False}),
        ("resin_skin", 5e-5, {}, "um", {49.0: True}),
        ("membrane_stress", -1e6, {}, "MPa", {0.9: True, 1.1: False}),
        ("support", 8.0, {}, "Hz", {8.0: True}),
        ("misorientation", 2.0, {}, "deg", {2.1: False}),
        ("sensor_mass", 0.02, {"x": 0.5, "y": 0.5}, "g", {3.9: True, 4.1: False}),  # 200 g, or weighed 400 g
        ("soft_clamp", 2.0, {"ratio": 1.5}, "", {0.059: True, 0.061: False}),
        ("outline", 0.1, {"form": "rectangle", "ratio": 2.0}, "% of the area", {0.99: True, 1.01: False}),
        ("outline", 0.1, {"form": "ellipse", "ratio": 1.0}, "% of the area", {0.1: None}),
    ],
)
def test_a_hidden_size_is_held_against_the_limits_that_are_stated_for_it(cause, size, aux, unit, above):
    hidden = truth(cause) | {"sizes": {cause: size}, "aux": {cause: aux} if aux else {}}
    for limit, expected in above.items():
        said = {"detectable": {cause: [limit, unit], "skew": [0.0, "deg"]}}
        assert scoring.above_limit({"file": DENSE, "truth": hidden}, said) is expected, limit
    if cause == "sensor_mass":
        assert scoring.hidden_size({"file": WEIGHED, "truth": hidden}) == pytest.approx(8e-3)


def test_a_misread_frequency_has_a_size_and_what_has_none_or_no_limit_is_not_counted() -> None:
    misread = {"file": DENSE, "truth": truth("outlier") | {"extra": {"shift_percent": -3.0}}}
    for limit, above in ((2.9, True), (3.1, False)):
        assert scoring.above_limit(misread, {"detectable": {"outlier": [limit, "%"]}}) is above
    for hidden in (truth(), truth("other"), truth("mode_identity"), truth("warp", "skew")):
        entry = {"file": DENSE, "truth": hidden | {"sizes": {"warp": 1.0, "skew": 5.0}}}
        assert scoring.above_limit(entry, {"detectable": {c: [0.1, "mm"] for c in ("warp", "other")}}) is None
    tested = {"file": DENSE, "truth": truth("warp") | {"sizes": {"warp": 1.0}}}
    for said in ({"detectable": {"skew": [0.1, "deg"]}}, {"error": "no"}):
        assert scoring.above_limit(tested, said) is None


def test_what_is_answered_is_not_asked_again(tmp_path: Path) -> None:
    entry, calls = {"id": "a", "file": "", "truth": {"plate": "T1"}}, []

    def diagnose(path: Path) -> dict[str, Any]:
        calls.append(path)
        raise ValueError("no such plate")

    path = tmp_path / "answers.jsonl"
    for _ in range(2):
        answering.answer([entry], path, diagnose, provenance={"commit": "c0ffee"})
    assert len(calls) == 1
    kept = {"error": "ValueError: no such plate", "commit": "c0ffee"}
    assert answering.answered(path)["a"].items() >= kept.items()
    path.write_text(2 * path.read_text("utf-8"), "utf-8")
    with pytest.raises(ValueError, match="a second answer to a"):
        answering.answered(path)


def test_a_set_is_sealed_once_of_committed_code_and_its_lists_stay_what_they_are(tmp_path: Path) -> None:
    git = partial(subprocess.run, cwd=tmp_path, check=True, capture_output=True)
    (tmp_path / "studies").mkdir()
    code, of_seal, made = tmp_path / "studies" / "code.py", tmp_path / "seal.json", tmp_path / "lists.jsonl"
    code.write_text("x = 1\n", "utf-8")
    git(["git", "init", "-q"])
    git(["git", "add", "studies"])
    git(["git", "-c", "user.name=a", "-c", "user.email=a@b", "commit", "-qm", "code"])
    code.write_text("x = 2\n", "utf-8")
    with pytest.raises(seal.SealError, match="differs"):
        seal.draw(of_seal, tmp_path)
    code.write_text("x = 1\n", "utf-8")
    drawn_seal = seal.draw(of_seal, tmp_path)
    assert drawn_seal["predictions"]["wrong claims"] == [0.0, 0.01]
    with pytest.raises(seal.SealError, match="is sealed"):
        seal.draw(of_seal, tmp_path)
    made.write_text("{}\n", "utf-8")
    with pytest.raises(seal.SealError, match="not the lists"):
        seal.require_closed(of_seal, made)
    seal.close(of_seal, made)
    assert seal.require_closed(of_seal, made)["seed"] == drawn_seal["seed"]
    made.write_text("{ }\n", "utf-8")
    for hold in (seal.close, seal.require_closed):
        with pytest.raises(seal.SealError, match="not the lists"):
            hold(of_seal, made)


def test_an_answer_is_of_todays_code_only_if_it_was_given_by_it(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr(fingerprints, "LEDGER", tmp_path / "fingerprints.json")
    monkeypatch.setattr(seal, "provenance", lambda tree: {"commit": "c0ffee"})
    own = STUDY._provenance(STUDY.HERE.parent)
    assert own == {"commit": "c0ffee", "fingerprint": fingerprints.fingerprint_of_study("15_claims")}
    assert STUDY._provenance(tmp_path) == {"commit": "c0ffee"}  # nothing is known of another tree
    entries = [{"id": f"clean-{k}", "file": DENSE, "truth": truth("warp")} for k in (1, 2)]
    path = tmp_path / "15_claims.json"
    for second, of in ((STUDY._provenance(tmp_path), fingerprints.UNKNOWN), (own, own["fingerprint"])):
        answers = {"clean-1": answer("none") | own, "clean-2": answer("none") | second}
        save_results(path, STUDY._results(False, {"development": (entries, {"diagnosis": answers})}))
        assert fingerprints.recorded() == {"15_claims": of}


@cache
def saved_lists(name: str) -> dict[str, dict[str, Any]]:
    lines = (DATA / f"{name}.jsonl").read_text("utf-8").splitlines()
    return {record["id"]: record for record in map(json.loads, lines)}


SEALED = ("clean-06", "prior-61-frequency_scale")
DEVELOPMENT = (
    *("two-01", "list-12", "strength-clamp_length-8", "former-both-tapers-3", "former-two-accelerometers-0"),
    *("former-four-pads-0", "beyond-cable-0", "beyond-drifting-plies-0"),
)


@pytest.mark.parametrize("name", [*SEALED, *DEVELOPMENT])
def test_saved_lists_are_those_that_their_seeds_and_names_make(name: str) -> None:
    of = "sealed" if name in SEALED else "development"
    seed = {"development": 5150, "sealed": json.loads((DATA / "seal.json").read_text("utf-8"))["seed"]}[of]
    assert list(saved_lists(of)) == sets.ordered(seed)
    assert json.loads(sets.line_of(sets.made(seed, name))) == saved_lists(of)[name]


# a size alone, a place (three parameters), a misread frequency
FIRST, SECOND = np.eye(8)[:1], np.eye(8)[1:2]
SEEN = references.Whitened(
    np.array([9.0, 0, 0, 0, 0, 0, 0, 2.0]),
    {"taper_x": 10 * FIRST, "damage": 10 * FIRST + 0.1 * SECOND, "outlier": np.eye(8)},
    {"taper_x": 10 * FIRST + SECOND, "damage": 10 * SECOND, "outlier": np.eye(8)},
)


def test_a_statistic_is_how_much_better_than_nothing_a_method_is_for_its_number_of_parameters() -> None:
    left = (10.0 - 9.0) ** 2 + 2.0**2
    assert references._largest_residual(SEEN) == (["taper_x"], 9.0)
    assert references._criterion(SEEN) == (["taper_x"], pytest.approx(85.0 - left - np.log(8.0)))
    margin = pytest.approx((85.0 - left) / 3.8415, rel=1e-4)
    assert references._likelihood_ratio(SEEN) == (["taper_x"], margin)
    assert references._matching_pursuit(SEEN) == (["outlier"], pytest.approx(81.0))
    alike = ("damage", "outlier", "taper_x")  # equally good, with 1, 3 and 2 parameters
    for causes, free in ((alike, 1), (alike[:2], 2), (alike[:1], 3)):
        seen = replace(SEEN, atoms=dict.fromkeys(causes, 9 * FIRST))
        assert references._criterion(seen) == ([causes[-1]], pytest.approx(81.0 - free * np.log(8.0)))
        assert references._likelihood_ratio(seen)[1] == pytest.approx(81.0 / 7.8147, rel=1e-4)  # the first


def test_a_second_cause_is_named_where_it_explains_half_of_what_the_first_does() -> None:
    one = {"taper_x": FIRST, "damage": 3 * SECOND}
    for second, causes in ((6.3, ["taper_x"]), (6.4, ["taper_x", "damage"])):
        seen = references.Whitened(9.0 * FIRST[0] + second * SECOND[0], {}, one)
        gained = 81.0 + (second**2 if len(causes) == 2 else 0.0)
        assert references._matching_pursuit(seen) == (causes, pytest.approx(gained))


def test_simple_methods_know_a_taper_a_misread_frequency_and_a_missed_mode(tapered) -> None:
    signatures, rng = (
        references.dictionary_of(PLATE, ("taper_x", "warp", "membrane_stress")),
        np.random.default_rng(4),
    )
    misread = lists.misread(PLATE, 40.0, rng)
    missed = lists.listed(PLATE, PLATE.drawn(rng), "one", {}, rng, missed=[0], causes=("mode_identity",))
    for (text, made), method in ((tapered, "likelihood_ratio"), (misread, "BIC"), (missed, "BIC")):
        entry = json.loads(json.dumps({"file": text, "truth": asdict(made)}))
        found = references.answers(signatures, entry)
        assert set(found) == set(references.METHODS)
        assert found[method]["causes"] == list(made.causes)
        assert all(record["statistic"] > 0.0 for record in found.values())


SCORED = ((9.0, 7.0, 6.0, 4.0), (8.0, 5.0, 3.0, 2.0))  # Statistics of right answers and of wrong ones.


@pytest.mark.parametrize(
    ("right", "wrong", "rate", "least", "claimed"),
    [
        (*SCORED, (0, 5), 9.0, (1, 0)),
        (*SCORED, (1, 9), 9.0, (1, 0)),
        (*SCORED, (1, 8), 6.0, (3, 1)),
        (*SCORED, (1, 5), 6.0, (3, 1)),
        (*SCORED, (2, 8), 4.0, (4, 2)),
        (*SCORED, (1, 1), 2.0, (4, 4)),
        ((8.0, 7.0), (7.0,), (0, 3), 8.0, (1, 0)),  # lists with equal statistics are claimed together
        ((8.0,), (9.0,), (0, 2), None, (0, 0)),  # the surest claim is wrong too often
    ],
)
def test_a_threshold_is_the_least_that_keeps_the_rate_of_wrong_claims(right, wrong, rate, least, claimed):
    statistics = {str(k): s for k, s in enumerate((*wrong, *right))}
    of = [scoring.WRONG] * len(wrong) + [scoring.RIGHT] * len(right)
    records = [{"id": k, "category": c} for k, c in zip(statistics, of, strict=True)]
    found = references.threshold(records, statistics, rate)
    counts = dict(zip((scoring.RIGHT, scoring.WRONG), claimed, strict=True))
    assert found == {"threshold": least, "lists": len(records), **counts}


def test_a_method_claims_from_its_threshold_on() -> None:
    said = {name: answer("named", "warp") | {"statistic": s} for name, s in (("a", 2.0), ("b", 1.9))}
    found = references.abstaining(said, 2.0)
    assert (found["a"], found["b"]["claim"], found["b"]["causes"]) == (said["a"], "none", [])
    assert said["b"]["claim"] == "named"
    assert references.abstaining(said, None)["a"]["claim"] == "none"


def test_simple_methods_answer_first_what_was_diagnosed_and_nothing_twice(tmp_path, monkeypatch) -> None:
    names = ["clean-00", "clean-01", "clean-02", "clean-03"]
    (tmp_path / "answers").mkdir()
    lines = [{"id": name, "plate": 0, "file": DENSE, "truth": truth()} for name in names]
    (tmp_path / "development.jsonl").write_text("".join(map(sets.line_of, lines)), "utf-8")
    (tmp_path / "answers" / "development_diagnosis.jsonl").write_text('{"id": "clean-02"}\n', "utf-8")
    asked: list[str] = []

    def named(dictionary: object, entry: dict[str, Any]) -> dict[str, Any]:
        asked.append(entry["id"])
        return {m: answer("named", "warp") | {"statistic": 1.0} for m in references.METHODS}

    monkeypatch.setattr(STUDY, "DATA", tmp_path)
    monkeypatch.setattr(references, "dictionary_of", lambda nominal: None)
    monkeypatch.setattr(references, "answers", named)
    STUDY.refer("development", -1.0, None)
    assert asked == []
    STUDY.refer("development", None, 3)
    STUDY.refer("development", 60.0, None)
    assert asked == ["clean-02", "clean-00", "clean-01", "clean-03"]
    kept = answering.answered(tmp_path / "answers" / "development_sparse_regression.jsonl")
    assert set(kept) == set(names)


LISTS = {r["id"]: r for r in answering.asked(DATA / "sealed.jsonl")}
OURS = answering.answered(DATA / "answers" / "sealed_diagnosis.jsonl")
# Files of the project that a score may not change.
RESULTS, PAGES = (PROJECT / "studies" / "results").iterdir(), (PROJECT / "docs").glob("*.md")
KEPT = (*RESULTS, *PAGES, *(DATA / "answers").iterdir(), PROJECT / "README.md")
ANSWERED = [name for name in OURS if LISTS[name]["truth"]["causes"]][:3]


def told(name: str) -> dict[str, Any]:
    causes = ["damage" if cause == "other" else cause for cause in LISTS[name]["truth"]["causes"]]
    return {"id": name, "claim": "class", "causes": causes}


def written(folder: Path, *lines: Any) -> Path:
    path = folder / "mine.jsonl"
    path.write_text("".join(f"{line if isinstance(line, str) else json.dumps(line)}\n" for line in lines))
    return path


@cache
def document() -> dict[str, Any]:
    return json.loads(json_text(diagnosis_result(misread(), 3).to_dict()))


def test_the_document_of_the_command_is_scored_as_our_own_answers_are() -> None:
    ours, mine = answering.reduced(document()), own_method.answer_of(document() | {"id": "any"})
    for key in ("claim", "causes", "probability", "detectable"):
        assert mine[key] == ours[key], key
    for key in ("constants", "baseline"):
        assert {n: dict(c) for n, c in mine[key].items()} == ours[key], key
    assert mine["detectable"]["outlier"][1] == "%"


def test_one_command_prints_the_scores_beside_ours_and_writes_nothing(tmp_path: Path, capsys) -> None:
    before = {path: path.read_bytes() for path in KEPT if path.is_file()}
    lines = [told(ANSWERED[0]), {"id": ANSWERED[1], "claim": "none", "causes": []}]
    lines.append(document() | {"id": ANSWERED[2]})
    STUDY.main(["--score", str(written(tmp_path, *lines))])
    said = capsys.readouterr().out.splitlines()
    assert said[0] == "|  | diagnosis | mine |"
    rows = {cells[0]: cells[1:] for cells in ([c.strip() for c in row.split("|")[1:-1]] for row in said[2:])}
    assert rows["lists"] == ["3", "3"]
    ours = [scoring.score(LISTS[name]["truth"], OURS[name])["category"] for name in ANSWERED]
    assert [rows[c][0] for c in scoring.CATEGORIES] == [str(ours.count(c)) for c in scoring.CATEGORIES]
    assert int(rows[scoring.RIGHT][1]) >= 1
    assert int(rows[scoring.MISSED][1]) == 1
    assert {path: path.read_bytes() for path in before} == before
    assert set(KEPT) >= set((DATA / "answers").iterdir())


def test_without_probabilities_and_constants_only_claims_are_scored(tmp_path: Path) -> None:
    records = own_method.read(written(tmp_path, *map(told, ANSWERED[:2])), set(LISTS))
    assert list(records) == ANSWERED[:2]
    scores = scoring.scored(LISTS.values(), records)
    figures = {row["what"]: row["number"] for row in scoring.figures(scores)}
    assert figures[scoring.TOO_SURE] == figures[scoring.COVERED] == 0
    assert figures[scoring.WRONG_CLAIMS] == 2
    said = own_method.table("mine", scores, [])  # not answered by the diagnosis
    assert "| lists | 0 | 2 |" in said
    assert "| claimed and right | 0 | 2 |" in said


@pytest.mark.parametrize(
    ("line", "why"),
    [
        ("{", "not JSON"),
        ([1], "not an object"),
        ({"id": ANSWERED[0]}, f"a second answer to {ANSWERED[0]}"),
        ({"id": "clean-99999"}, "'clean-99999': no list of this set"),
        ({"id": None}, "None: no list of this set"),
        ({"claim": "sure"}, "\"claim\" 'sure': one of named, class, pair, other, undecided, none"),
        ({"causes": "warp"}, "\"causes\" 'warp': a list of names"),
        ({"causes": ["wrap"]}, "\"causes\" ['wrap']: one of air, "),
        ({"claim": "named", "causes": []}, 'a claim "named" has causes'),
        ({"probability": 1.2}, '"probability" 1.2: 0 to 1'),
        ({"probability": "high"}, "\"probability\" 'high': 0 to 1"),
        ({"constants": {"E1_GPa": {"q025": 1.0}}}, '"constants" of E1_GPa: "q025" and "q975", or'),
        ({"constants": {"E1_GPa": 140.0}}, '"constants": an object of objects'),
        ({"constants": {"E1_GPa": {"mean": float("nan"), "sd": 1.0}}}, '"constants" of E1_GPa'),
        ({"baseline": 3}, '"baseline" 3: an object'),
        ({"detectable": {"warp": 1.0}}, '"detectable": a list'),
        ({"detectable": [1.0]}, '"detectable": each with'),
        ({"detectable": [{"cause": "warp"}]}, '"detectable": each with "cause", "smallest" and "unit"'),
        ({"detectable": [{"cause": "warp", "smallest": 1.0, "unit": "inch"}]}, "of warp: 1.0 'inch'"),
    ],
)
def test_what_cannot_be_scored_is_refused_with_its_line(line, why: str, tmp_path: Path, capsys) -> None:
    written(tmp_path, told(ANSWERED[0]), told(ANSWERED[1]) | line if isinstance(line, dict) else line)
    (tmp_path / "empty.jsonl").touch()
    for name, place, words in (("mine", ", line 2: ", why), ("none", "", ""), ("empty", ": ", "no answers")):
        with pytest.raises(SystemExit) as stop:
            STUDY.main(["--score", str(tmp_path / f"{name}.jsonl")])
        assert stop.value.code == 2
        said = capsys.readouterr().err
        assert all(word in said for word in (f"{name}.jsonl{place}", words))
