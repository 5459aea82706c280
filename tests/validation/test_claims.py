"""The benchmark of claims: lists that hold what they say, scores as a user reads, results that are saved."""

import json
import subprocess
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import cpam_bayes as cb
from cpam_bayes.effects import CATALOGUE
from tests.test_studies import script
from validation import brick_lists, fingerprints
from validation.claims import answering, references, scoring, seal, sets, telling
from validation.independent import drawn, lists
from validation.independent.true_plate import FLAWS, TruePlate, natural_frequencies
from validation.reporting import save_results, saved_results, with_saved

ORDER = ("C1", "D1", "D3")


def test_cases_that_were_not_run_again_stay_in_order(tmp_path: Path) -> None:
    path = tmp_path / "08.json"
    save_results(
        path,
        {
            "seeds": 3,
            "cases": [{"case": "D3", "x": 1}, {"case": "C1", "x": 1}, {"case": "C1", "x": 2}],
            "cost": [{"case": "D1", "s": 4}, {"case": "no longer a case", "s": 5}],
        },
    )
    new = {"seeds": 20, "cases": [{"case": "D1", "x": 7}, {"case": "C1", "x": 8}], "cost": []}
    both = with_saved(new, path, ORDER)
    assert both["seeds"] == 20
    assert both["cases"] == [{"case": "C1", "x": 8}, {"case": "D1", "x": 7}, {"case": "D3", "x": 1}]
    assert both["cost"] == [{"case": "D1", "s": 4}]
    assert new["cases"] == [{"case": "D1", "x": 7}, {"case": "C1", "x": 8}], (
        "the results are left as they are"
    )


def test_a_case_can_be_named_otherwise(tmp_path: Path) -> None:
    path = tmp_path / "12.json"
    save_results(path, {"groups": [{"plates": ["C1", "C2"]}, {"plates": ["C1"], "p": 1}]})
    both = with_saved(
        {"groups": [{"plates": ["C1"], "p": 2}]}, path, [("C1",), ("C1", "C2")], lambda g: tuple(g["plates"])
    )
    assert both == {"groups": [{"plates": ["C1"], "p": 2}, {"plates": ["C1", "C2"]}]}


def test_results_come_back_as_they_were_and_nan_is_refused_before_anything_is_lost(tmp_path: Path) -> None:
    path = tmp_path / "results" / "01.json"
    assert saved_results(path) == {}
    results = {"quick": False, "cases": [{"case": "C1", "rms": 1.5}]}
    save_results(path, results)
    with pytest.raises(ValueError, match="JSON"):
        save_results(path, {"cases": [{"case": "C1", "rms": np.nan}]})
    assert saved_results(path) == results


PLATE = lists.PLATES[3]
DATA = Path(__file__).parents[2] / "studies" / "data" / "claims"


@pytest.fixture(scope="module")
def tapered() -> tuple[str, lists.Truth]:
    return lists.single(PLATE, "taper_x", 16.0, np.random.default_rng(3), stated=False)


def test_a_list_has_the_signal_to_noise_that_was_asked_for(tapered: tuple[str, lists.Truth]) -> None:
    # sought on a coarse mesh, measured on the fine one
    assert tapered[1].extra["signal_to_noise"] == pytest.approx(16.0, rel=0.1)


def test_a_list_is_a_plate_file_that_says_what_the_truth_says(
    tapered: tuple[str, lists.Truth], tmp_path: Path
) -> None:
    path = tmp_path / "plate.toml"
    path.write_text(tapered[0], "utf-8")
    read = cb.read_plate(str(path))
    measured = np.asarray(read.measurement.frequencies)
    assert read.measurement.relative_std is None
    assert set(read.material.sd) == set(tapered[1].constants)
    # 0.2 % of noise and the rounding to 0.1 Hz
    np.testing.assert_allclose(measured, tapered[1].true_hz, rtol=0.011)


def test_drawn_plates_can_be_read_and_are_as_stated_within_their_tolerances(tmp_path: Path) -> None:
    rng = np.random.default_rng(8)
    off = []
    for k in range(40):
        own = drawn.plate(rng, lambda plate: True)
        path = tmp_path / f"{k}.toml"
        path.write_text(own.file([100.0 + 50 * i for i in range(own.n_modes)], stated=own.noise), "utf-8")
        read = cb.read_plate(str(path))
        np.testing.assert_allclose(read.plate.layup.angles_deg, own.plate.angles_deg)
        assert read.plate.edges == own.plate.edges
        true = own.drawn(rng)
        off.append(true.thickness / own.plate.thickness - 1.0)
        assert set(true.constants) == set(own.bounds)
    # a gauge is off by one per cent; 40 plates
    assert 0.006 < np.std(off) < 0.014


def test_a_drawn_plate_is_biased_as_the_most_similar_bricks_are() -> None:
    cases = json.loads(drawn.BIASES.read_text("utf-8"))["cases"]
    case = next(c for c in cases if c["case"] == "carbon, quasi-isotropic, FFFF, h/b = 1/50")
    constants = {"E1": 130e9, "E2": 9e9, "nu12": 0.3, "G12": 5e9}
    angles = (0.0, 45.0, -45.0, 90.0, 90.0, -45.0, 45.0, 0.0)
    plate = TruePlate(0.24, 0.18, 0.0036, 1580.0, "FFFF", angles, constants)
    bias = drawn.bias(plate, 12)
    shifts = [np.log(m["bricks_hz"] / m["ritz_hz"]) for m in case["modes"]]
    np.testing.assert_allclose(bias[:10], shifts)
    assert bias[10:] == (bias[9],) * 2
    f = natural_frequencies(replace(plate, mesh=8), 3)
    biased = natural_frequencies(replace(plate, mesh=8, bias=tuple(shifts)), 3)
    np.testing.assert_allclose(biased, f * np.exp(shifts[:3]))


def test_a_weighed_plate_states_what_it_weighs_and_a_wrong_density_is_a_wrong_weight() -> None:
    own = next(
        p
        for p in (drawn.plate(np.random.default_rng(k), lambda plate: True) for k in range(40))
        if p.weighed and not set(p.plate.edges) - {"F"}
    )
    rng = np.random.default_rng(1)
    text, made = lists.single(own, "thickness", None, rng, size=-0.2)
    stated = next(float(line.split("=")[1]) for line in text.splitlines() if line.startswith("mass_g"))
    assert "density" not in text
    # a thickness of 0.8 with one per cent of gauge, one of density, 0.2 of balance
    assert stated == pytest.approx(0.8e3 * own.plate.total_mass, rel=0.05)
    heavy, _ = lists.single(own, "density", None, np.random.default_rng(1), size=0.3)
    light, _ = lists.listed(own, own.plate, "clean", {}, np.random.default_rng(1))
    of = [next(ln for ln in t.splitlines() if ln.startswith("mass_g")) for t in (heavy, light)]
    grams = [float(line.split("=")[1]) for line in of]
    assert grams[0] == pytest.approx(grams[1], rel=0.06)
    assert made.causes == ("thickness",)


def test_every_cause_that_elements_can_have_is_drawn_and_every_list_has_a_name_of_its_own() -> None:
    assert len(sets.PLANS) == len([*drawn.plans(), *brick_lists.plans()])
    hidden = {name.split("-")[1] for name in sets.PLANS if name.startswith("strength-")}
    assert hidden == set(FLAWS)
    # air is always there; layers and sides exchanged are hidden by tests/diagnosis/test_hidden_effects.py
    elsewhere = {"air", "layup", "edge_mass", "soft_support", "swapped_sides"}
    of_list = {"mode_identity", "outlier", "material"}
    assert {e.name for e in CATALOGUE} - elsewhere - of_list <= hidden
    assert {scoring.GROUPS[name.split("-")[0]] for name in sets.PLANS} == set(scoring.GROUPS.values())


@pytest.mark.parametrize(
    "name", ["former-two-accelerometers-0", "beyond-cable-0", "former-four-pads-0", "beyond-drifting-plies-0"]
)
def test_a_list_depends_on_its_seed_and_its_name_alone(name: str) -> None:
    once, again, other = (json.loads(sets.line_of(sets.made(k, name))) for k in (5, 5, 6))
    assert once == again
    assert once["file"] != other["file"]
    assert once["truth"]["extra"]["signal_to_noise"] > 0.0


def test_names_of_one_physical_thing_are_few_and_symmetric() -> None:
    plate = PLATE.plate
    assert lists.same_thing(PLATE, plate, {"length": (0.01, {})}) == ("clamp_length",)
    assert lists.same_thing(PLATE, plate, {"clamp_length": (1e-3, {})}) == ("length",)
    assert lists.same_thing(PLATE, plate, {"clamp_rotation": (0.1, {})}) == ("soft_clamp",)
    both: dict[str, tuple[float, Any]] = {"clamp_rotation": (0.1, {}), "taper_y": (0.1, {})}
    assert lists.same_thing(PLATE, plate, both) == ("soft_clamp",)
    # a free plate has no clamp
    free = replace(plate, edges="FFFF")
    assert lists.same_thing(PLATE, free, {"length": (0.01, {})}) == ()
    assert lists.same_thing(PLATE, plate, {"warp": (1e-3, {})}) == ()


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
def test_a_claim_is_counted_as_a_user_reads_it(
    hidden: dict[str, Any], answered: dict[str, Any], category: str, right: bool
) -> None:
    found = scoring.score(hidden, answered)
    assert found["category"] == category
    assert found["right"] is right


FILE = "[plate]\nlength_mm = 200\nwidth_mm = 100\nthickness_mm = 5\n{}"
DENSE, WEIGHED = FILE.format("density_kg_m3 = 2000"), FILE.format("mass_g = 400")


@pytest.mark.parametrize(
    ("cause", "size", "aux", "limit", "above"),
    [
        ("taper_x", -0.05, {}, [4.9, "%"], True),
        ("taper_x", -0.05, {}, [5.1, "%"], False),
        ("taper_x", 0.05, {}, [None, "%"], False),
        ("warp", 1e-3, {}, [0.99, "mm"], True),
        ("warp", 1e-3, {}, [1.01, "mm"], False),
        ("resin_skin", 5e-5, {}, [49.0, "um"], True),
        ("membrane_stress", -1e6, {}, [1.1, "MPa"], False),
        ("membrane_stress", -1e6, {}, [0.9, "MPa"], True),
        ("support", 8.0, {}, [8.0, "Hz"], True),
        ("misorientation", 2.0, {}, [2.1, "deg"], False),
        # a part of the plate's mass: 200 g, or as weighed 400 g
        ("sensor_mass", 0.02, {"x": 0.5, "y": 0.5}, [3.9, "g"], True),
        ("sensor_mass", 0.02, {"x": 0.5, "y": 0.5}, [4.1, "g"], False),
        ("soft_clamp", 2.0, {"ratio": 1.5}, [0.059, ""], True),
        ("soft_clamp", 2.0, {"ratio": 1.5}, [0.061, ""], False),
        ("outline", 0.1, {"form": "rectangle", "ratio": 2.0}, [0.99, "% of the area"], True),
        ("outline", 0.1, {"form": "rectangle", "ratio": 2.0}, [1.01, "% of the area"], False),
        ("outline", 0.1, {"form": "ellipse", "ratio": 1.0}, [0.1, "% of the area"], None),
    ],
)
def test_a_hidden_size_is_held_against_the_limit_that_is_stated_for_it(
    cause: str, size: float, aux: dict[str, Any], limit: list[Any], above: bool | None
) -> None:
    hidden = truth(cause) | {"sizes": {cause: size}, "aux": {cause: aux} if aux else {}}
    said = {"detectable": {cause: limit, "skew": [0.0, "deg"]}}
    assert scoring.above_limit({"file": DENSE, "truth": hidden}, said) is above


def test_a_weighed_plate_has_the_mass_that_its_file_states() -> None:
    entry = {"file": WEIGHED, "truth": truth("sensor_mass") | {"sizes": {"sensor_mass": 0.02}}}
    assert scoring.hidden_size(entry) == pytest.approx(8e-3)


def test_a_misread_frequency_has_a_size_and_what_has_none_or_no_limit_is_not_counted() -> None:
    misread = {"file": DENSE, "truth": truth("outlier") | {"extra": {"shift_percent": -3.0}}}
    assert scoring.above_limit(misread, {"detectable": {"outlier": [2.9, "%"]}}) is True
    assert scoring.above_limit(misread, {"detectable": {"outlier": [3.1, "%"]}}) is False
    for hidden in (truth(), truth("other"), truth("mode_identity"), truth("warp", "skew")):
        entry = {"file": DENSE, "truth": hidden | {"sizes": {"warp": 1.0, "skew": 5.0}}}
        assert scoring.above_limit(entry, {"detectable": {c: [0.1, "mm"] for c in ("warp", "other")}}) is None
    tested = {"file": DENSE, "truth": truth("warp") | {"sizes": {"warp": 1.0}}}
    assert scoring.above_limit(tested, {"detectable": {"skew": [0.1, "deg"]}}) is None
    assert scoring.above_limit(tested, {"error": "no"}) is None


def test_what_is_hidden_above_its_limit_must_be_claimed_alone_or_in_a_class() -> None:
    entries, answers = [], {}
    said = [answer("named", "warp"), answer("class", "skew", "warp"), answer("named", "skew"), answer("none")]
    for k, (size, of) in enumerate([*((2e-3, a) for a in said), *((5e-4, a) for a in said[2:])]):
        entries.append(
            {"id": f"prior-{k}", "file": DENSE, "truth": truth("warp") | {"sizes": {"warp": size}}}
        )
        answers[f"prior-{k}"] = of | {"detectable": {"warp": [1.0, "mm"]}}
    # nothing is hidden: neither above nor below
    entries.append({"id": "clean-0", "file": DENSE, "truth": truth()})
    answers["clean-0"] = answer("none") | {"detectable": {"warp": [1.0, "mm"]}}
    found = scoring.summary(scoring.scored(entries, answers))
    rows = {row["what"]: row for row in found["figures"]}
    above, below = rows[scoring.ABOVE], rows[scoring.BELOW]
    assert (above["value"], above["number"]) == (0.5, 4)
    assert above["interval"] == scoring.interval(2, 4)
    assert (below["value"], below["number"]) == (0.0, 2)
    # the chance that a limit states, which no seal predicts
    said = telling.section(7, found, []).splitlines()
    (row,) = (line for line in said if line.startswith(f"| {scoring.ABOVE} | 0.95 to 1 | 0.500 |"))
    assert row.endswith("| missed; stated by the answers, not sealed |")
    assert any(line.startswith(f"| {scoring.BELOW} | - | 0.000 |") for line in said)


def test_an_interval_covers_the_truth_or_does_not() -> None:
    assert scoring.score(truth("warp"), answer("none"))["inside"] == {"E1_GPa": True}
    far = answer("none")
    far["constants"] = {"E1_GPa": {"mean": 43.0, "sd": 1.0}}
    assert scoring.score(truth("warp"), far)["inside"] == {"E1_GPa": False}


def test_stated_probability_is_held_against_how_often_it_is_right() -> None:
    records = [{"claim": "named", "probability": 0.95, "right": i < 90} for i in range(100)]
    found = scoring.honesty(records, ("named",))
    assert found["difference"] == pytest.approx(0.05)
    assert found["standard_error"] == pytest.approx(np.sqrt(0.95 * 0.05 / 100), rel=0.05)


def test_constants_of_one_list_are_not_independent() -> None:
    records = [{"id": f"clean-{k}", "inside": dict.fromkeys("abcd", k < 9)} for k in range(10)]
    found = scoring.coverage(records)
    assert found["share"] == pytest.approx(0.9)
    # of ten lists, not of forty constants
    assert found["standard_error"] == pytest.approx(np.sqrt(0.9 * 0.1 / 10), rel=0.02)


def test_the_interval_of_a_share_is_exact() -> None:
    # none of 30: 1 - 0.025^(1/30)
    assert scoring.interval(0, 30) == pytest.approx((0.0, 1.0 - 0.025 ** (1 / 30)))


def test_what_is_answered_is_not_asked_again(tmp_path: Path) -> None:
    entry = {"id": "a", "file": "", "truth": {"plate": "T1"}}
    calls = []

    def diagnose(path: Path) -> dict[str, Any]:
        calls.append(path)
        raise ValueError("no such plate")

    path = tmp_path / "answers.jsonl"
    for _ in range(2):
        answering.answer([entry], path, diagnose, provenance={"commit": "c0ffee"})
    assert len(calls) == 1
    assert answering.answered(path)["a"]["error"] == "ValueError: no such plate"
    assert answering.answered(path)["a"]["commit"] == "c0ffee"
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


def test_the_summary_counts_wrong_claims_with_their_lists() -> None:
    records = [
        {"id": f"prior-{k}-warp", "commit": "c0ffee", "date": "today", **scoring.score(truth("warp"), said)}
        for k, said in enumerate((answer("named", "skew"), answer("named", "warp")))
    ]
    found = scoring.summary(records)
    assert [w["id"] for w in found["wrong"]] == ["prior-0-warp"]
    assert "| prior-0-warp | warp | named: skew | 0.950 |" in telling.section(2, found, [])
    wrong = next(row for row in found["figures"] if row["what"] == "wrong claims")
    assert (wrong["value"], wrong["number"]) == (0.5, 2)
    assert wrong["what"] in seal.PREDICTIONS
    assert set(seal.PREDICTIONS) <= {row["what"] for row in found["figures"]}


def figure(what: str, value: float, low: float, high: float) -> dict[str, Any]:
    return {"what": what, "value": value, "interval": (low, high), "number": 50, "unit": "lists"}


def test_a_prediction_that_is_missed_is_named() -> None:
    outcomes = {
        "met": figure("a", 0.96, 0.9, 1.0),
        "missed; its interval reaches it": figure("a", 0.92, 0.88, 0.96),
        "missed": figure("a", 0.80, 0.7, 0.9),
    }
    for outcome, row in outcomes.items():
        assert telling._figure(row, (0.93, 0.97))[-1] == outcome
    assert telling._figure(outcomes["met"], None)[1] == telling._figure(outcomes["met"], None)[-1] == "-"


def told_by(commits: str, wrong: str) -> list[dict[str, Any]]:
    """Scores of lists, each answered by the commit at its place; an answer is wrong where it says so."""
    entries = [{"id": f"prior-{k}", "file": DENSE, "truth": truth("warp")} for k in range(len(commits))]
    answers = {
        f"prior-{k}": answer("named", "skew" if failed == "x" else "warp")
        | {"commit": commit, "date": "2026-11-27", "dirty": k == 0}
        for k, (commit, failed) in reversed([*enumerate(zip(commits, wrong, strict=True))])
    }
    return scoring.scored(entries, answers)


def test_each_state_of_the_code_that_answered_has_its_own_figures() -> None:
    records = told_by("aabbb", "x---x")
    engines = scoring.by_engine(records)
    # in the order of the answers, not of the lists
    assert [(e["commit"], e["lists"], e["dirty"]) for e in engines] == [("b", 3, 0), ("a", 2, 1)]
    said = telling.section(5, scoring.summary(records), engines)
    assert "2 states of it answered, each" in said
    assert "| b | 2026-11-27 | 3 | 0 | 1.000 of 3 | " in said
    assert "| a | 2026-11-27 | 2 | 1 | 1.000 of 2 | " in said
    alone = scoring.by_engine(told_by("aa", "--"))
    assert "states of it" not in telling.section(2, scoring.summary(records), alone)


def test_patterns_are_counted_each_by_itself_with_the_constants_held() -> None:
    outside = answer("named", "skew") | {"constants": {"E1_GPa": {"mean": 43.0, "sd": 1.0}}}
    of_tape = {"former-tape-0": answer("named", "warp"), "former-tape-1": answer("undecided")}
    answers = {**of_tape, "former-tape-2": outside, "beyond-loose-core-0": answer("none"), "prior-0": outside}
    entries = [{"id": name, "file": DENSE, "truth": truth("warp")} for name in answers]
    said = telling.section(5, scoring.summary(scoring.scored(entries, answers)), [])
    assert "| tape | 1/1/0/1 | 2/3 |\n| loose core | 0/0/1/0 | 1/1 |\n\n" in said


def test_ways_to_be_misled_are_counted_the_commonest_first() -> None:
    weak, unseen = truth("skew") | {"ratio": 4.0}, truth("warp") | {"ratio": 0.2}
    entries = [(unseen, "none")] * 3 + [(weak, "none"), (weak, "named"), (truth(), "none")]
    lists_of = [{"id": f"prior-{k}", "file": DENSE, "truth": of} for k, (of, _) in enumerate(entries)]
    answers = {
        f"prior-{k}": answer(claim, *(["warp"] if claim == "named" else []))
        for k, (_, claim) in enumerate(entries)
    }
    found = scoring.summary(scoring.scored(lists_of, answers))
    first, second, third = found["misled"]
    assert (first["way"], first["below"], first["number"], first["of"]) == (scoring.MISSED, 1.0, 3, 3)
    assert first["causes"] == {"warp": 3}
    assert (second["way"], second["from"], second["number"], second["of"]) == (scoring.MISSED, 1.0, 1, 2)
    assert (third["number"], third["of"], third["causes"]) == (1, 6, {"skew": 1})
    sealed = {"predictions": seal.PREDICTIONS}
    said = " ".join(telling.in_short(6, found, sealed).split())
    assert "signal to noise below 1: 3 of 3 missed); weak errors (1 to 8: 1 of 2 missed); " in said
    assert "another cause claimed (1 of 6: `skew` called `warp`)" in said
    found["wrong"][0] |= {"claimed": ["air", "damage", "warp"]}
    assert "`skew` called `air` or `damage` or others)" in " ".join(
        telling.in_short(6, found, sealed).split()
    )
    assert "([all 6 answered]" in said
    assert "1 of 6 lists are claimed wrongly (at most 1 % predicted)" in said
    # of the one claim, which is wrong
    stated = scoring.figure_of(found, scoring.TOO_SURE)
    assert f"too sure by {stated['value']:.2f} ({stated['interval'][0]:.2f} to" in said


def test_an_answer_is_of_todays_code_only_if_it_was_given_by_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    study = script("studies", "15_claims")
    monkeypatch.setattr(fingerprints, "LEDGER", tmp_path / "fingerprints.json")
    monkeypatch.setattr(seal, "provenance", lambda tree: {"commit": "c0ffee"})
    own = study._provenance(study.HERE.parent)
    assert own == {"commit": "c0ffee", "fingerprint": fingerprints.fingerprint_of_study("15_claims")}
    # of another tree nothing is known
    assert study._provenance(tmp_path) == {"commit": "c0ffee"}
    entries, _ = benchmark({"clean-1": ("warp", 1.0), "clean-2": ("warp", 1.0)})
    path = tmp_path / "15_claims.json"
    for second, of in ((study._provenance(tmp_path), fingerprints.UNKNOWN), (own, own["fingerprint"])):
        answers = {"clean-1": answer("none") | own, "clean-2": answer("none") | second}
        save_results(path, study._results(False, {"development": (entries, {"diagnosis": answers})}))
        assert fingerprints.recorded() == {"15_claims": of}


@pytest.mark.parametrize("name", ["development", "sealed"])
def test_saved_lists_are_those_that_their_seeds_make(name: str) -> None:
    saved = [json.loads(line) for line in (DATA / f"{name}.jsonl").read_text("utf-8").splitlines()]
    of_seal = json.loads((DATA / "seal.json").read_text("utf-8"))
    seed = {"development": 5150, "sealed": of_seal["seed"]}[name]
    assert [r["id"] for r in saved] == sets.ordered(seed)
    first = next(r for r in saved if r["id"].startswith("clean"))
    again = json.loads(sets.line_of(sets.made(seed, first["id"])))
    assert again["file"] == first["file"]


# What users do instead


@pytest.fixture(scope="module")
def signatures() -> references.Dictionary:
    return references.dictionary_of(PLATE, ("taper_x", "warp", "membrane_stress"))


def test_simpler_methods_name_a_cause_or_none(
    signatures: references.Dictionary, tapered: tuple[str, lists.Truth]
) -> None:
    entry = json.loads(json.dumps({"file": tapered[0], "truth": asdict(tapered[1])}))
    found = references.answers(signatures, entry)
    assert set(found) == set(references.METHODS)
    assert found["likelihood_ratio"]["causes"] == ["taper_x"]
    assert all(record["statistic"] > 0.0 for record in found.values())


# Eight modes and three causes: with a size alone, at a place (three parameters), a misread frequency.
FIRST, SECOND = np.eye(8)[:1], np.eye(8)[1:2]
SEEN = references.Whitened(
    np.array([9.0, 0, 0, 0, 0, 0, 0, 2.0]),
    {"taper_x": 10 * FIRST, "damage": 10 * FIRST + 0.1 * SECOND, "outlier": np.eye(8)},
    {"taper_x": 10 * FIRST + SECOND, "damage": 10 * SECOND, "outlier": np.eye(8)},
)


def test_a_statistic_is_how_much_better_a_method_is_than_nothing() -> None:
    left = (10.0 - 9.0) ** 2 + 2.0**2
    assert references._largest_residual(SEEN) == (["taper_x"], 9.0)
    assert references._criterion(SEEN) == (["taper_x"], pytest.approx(85.0 - left - np.log(8.0)))
    margin = pytest.approx((85.0 - left) / 3.8415, rel=1e-4)
    assert references._likelihood_ratio(SEEN) == (["taper_x"], margin)
    assert references._matching_pursuit(SEEN) == (["outlier"], pytest.approx(81.0))


def test_more_parameters_cost_more() -> None:
    # all three explain the residual alike: 1, 3 and 2 parameters
    alike = {"damage": 9 * FIRST, "outlier": 9 * FIRST, "taper_x": 9 * FIRST}
    for causes, free, five_percent in (
        (["damage", "outlier", "taper_x"], 1, 7.8147),
        (["damage", "outlier"], 2, 7.8147),
        (["damage"], 3, 7.8147),
    ):
        seen = replace(SEEN, atoms={c: alike[c] for c in causes})
        assert references._criterion(seen) == (causes[-1:], pytest.approx(81.0 - free * np.log(8.0)))
        # the first of those of one likelihood
        assert references._likelihood_ratio(seen)[1] == pytest.approx(81.0 / five_percent, rel=1e-4)


def test_a_second_cause_is_named_where_it_explains_half_of_what_the_first_does() -> None:
    one = {"taper_x": FIRST, "damage": 3 * SECOND}
    for second, causes in ((6.3, ["taper_x"]), (6.4, ["taper_x", "damage"])):
        seen = references.Whitened(9.0 * FIRST[0] + second * SECOND[0], {}, one)
        gained = 81.0 + (second**2 if len(causes) == 2 else 0.0)
        assert references._matching_pursuit(seen) == (causes, pytest.approx(gained))


def test_simple_methods_know_a_misread_frequency_and_a_missed_mode(
    signatures: references.Dictionary,
) -> None:
    rng = np.random.default_rng(4)
    for text, made in (
        lists.misread(PLATE, 40.0, rng),
        lists.listed(PLATE, PLATE.drawn(rng), "one", {}, rng, missed=[0], causes=("mode_identity",)),
    ):
        entry = json.loads(json.dumps({"file": text, "truth": asdict(made)}))
        found = references.answers(signatures, entry)
        assert found["BIC"]["causes"] == list(made.causes)


def judged(*outcomes: tuple[float, str]) -> tuple[list[dict[str, Any]], dict[str, float]]:
    """Scores of lists and their statistics."""
    records = [{"id": str(k), "category": category} for k, (_, category) in enumerate(outcomes)]
    return records, {str(k): statistic for k, (statistic, _) in enumerate(outcomes)}


SURE = (9.0, scoring.RIGHT), (8.0, scoring.WRONG), (7.0, scoring.RIGHT), (6.0, scoring.RIGHT)
UNSURE = (5.0, scoring.WRONG), (4.0, scoring.RIGHT), (3.0, scoring.WRONG), (2.0, scoring.WRONG)


@pytest.mark.parametrize(
    ("rate", "least", "right", "wrong"),
    [
        ((0, 5), 9.0, 1, 0),
        ((1, 9), 9.0, 1, 0),
        ((1, 8), 6.0, 3, 1),
        ((1, 5), 6.0, 3, 1),
        ((2, 8), 4.0, 4, 2),
        ((1, 1), 2.0, 4, 4),
    ],
)
def test_a_threshold_is_the_least_that_keeps_the_rate_of_wrong_claims(
    rate: tuple[int, int], least: float, right: int, wrong: int
) -> None:
    found = references.threshold(*judged(*UNSURE, *SURE), rate)
    assert found == {"threshold": least, "lists": 8, scoring.RIGHT: right, scoring.WRONG: wrong}
    assert wrong * rate[1] <= rate[0] * 8


def test_lists_of_one_statistic_are_claimed_together() -> None:
    tied = judged((8.0, scoring.RIGHT), (7.0, scoring.RIGHT), (7.0, scoring.WRONG))
    assert references.threshold(*tied, (0, 3))["threshold"] == 8.0


def test_a_method_whose_surest_claim_is_wrong_too_often_always_abstains() -> None:
    found = references.threshold(*judged((9.0, scoring.WRONG), (8.0, scoring.RIGHT)), (0, 2))
    assert found == {"threshold": None, "lists": 2, scoring.RIGHT: 0, scoring.WRONG: 0}
    said = {"a": answer("named", "warp") | {"statistic": 9.0}}
    assert references.abstaining(said, None)["a"]["claim"] == "none"


def test_a_method_claims_from_its_threshold_on() -> None:
    said = {name: answer("named", "warp") | {"statistic": s} for name, s in (("a", 2.0), ("b", 1.9))}
    found = references.abstaining(said, 2.0)
    assert found["a"] == said["a"]
    assert (found["b"]["claim"], found["b"]["causes"]) == ("none", [])
    assert said["b"]["claim"] == "named"


def benchmark(named: dict[str, tuple[str, float]]) -> tuple[list[dict[str, Any]], dict[str, dict[str, Any]]]:
    """Lists that hide a warp of signal to noise 16, and a method's answers: the cause and the statistic."""
    hidden = truth("warp") | {"ratio": 16.0}
    entries = [{"id": name, "file": DENSE, "truth": hidden} for name in named]
    return entries, {k: answer("named", cause) | {"statistic": s} for k, (cause, s) in named.items()}


def test_thresholds_come_from_the_lists_for_development_alone_and_the_wrong_rate_is_kept_there() -> None:
    study = script("studies", "15_claims")
    trial = {
        "strength-warp-1": ("skew", 3.0),
        "strength-warp-2": ("warp", 5.0),
        "strength-warp-3": ("warp", 4.0),
    }
    entries, named = benchmark(trial)
    mine = {name: answer("named", "warp") for name in trial}
    # what is sealed has statistics that would choose another threshold
    final = {
        "strength-warp-1": ("skew", 9.0),
        "strength-warp-2": ("warp", 3.9),
        "strength-warp-3": ("warp", 4.0),
    }
    sealed, claimed = benchmark(final)
    only_two = {k: v for k, v in claimed.items() if k != "strength-warp-2"}
    of_user = {name: answer("none") for name in final}
    found = study._results(
        False,
        {
            "development": (entries, {"diagnosis": mine, "BIC": named}),
            "sealed": (sealed, {"BIC": only_two, "diagnosis": mine, "my own": of_user}),
        },
    )
    assert found["thresholds"]["rate"] == [0, 3]
    chosen = found["thresholds"]["methods"]
    assert chosen == {"BIC": {"threshold": 4.0, "lists": 3, scoring.RIGHT: 2, scoring.WRONG: 0}}
    ours = found["beside"]["development"]["engines"]["BIC"]["by_ratio"]
    assert [(r["what"], r[scoring.RIGHT], r[scoring.MISSED]) for r in ours] == [(" 16", 2, 1)]
    assert found["sets"]["sealed"]["lists"] == 3
    beside = found["beside"]["sealed"]
    assert (beside["lists"], list(beside["engines"])) == (2, ["diagnosis", "BIC", "my own"])
    (row,) = beside["engines"]["BIC"]["by_kind"]
    assert (row["lists"], row[scoring.RIGHT], row[scoring.WRONG], row[scoring.MISSED]) == (2, 1, 1, 0)
    said = study.sections(found)["sealed"]
    assert "on the 2 lists that all answered" in said
    assert "(0 of 3)" in said
    assert "| diagnosis | - | - | 2 | 0 | 2 of 2 |" in said
    assert "| BIC, difference | 4 | 2, 0, 3 | 1 | 1 | 1 of 2 |" in said
    assert "0 wrong by the diagnosis, 0 to 1 by the others" in " ".join(said.split())
    assert "| my own | - | - | 0 | 0 | 0 of 2 |" in said


def test_simple_methods_answer_first_what_the_diagnosis_answered_and_nothing_twice(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    study = script("studies", "15_claims")
    names = ["clean-00", "clean-01", "clean-02", "clean-03"]
    (tmp_path / "answers").mkdir()
    lines = [{"id": name, "plate": 0, "file": DENSE, "truth": truth()} for name in names]
    (tmp_path / "development.jsonl").write_text("".join(map(sets.line_of, lines)), "utf-8")
    (tmp_path / "answers" / "development_diagnosis.jsonl").write_text('{"id": "clean-02"}\n', "utf-8")
    asked: list[str] = []

    def named(dictionary: object, entry: dict[str, Any]) -> dict[str, Any]:
        asked.append(entry["id"])
        return {m: answer("named", "warp") | {"statistic": 1.0} for m in references.METHODS}

    monkeypatch.setattr(study, "DATA", tmp_path)
    monkeypatch.setattr(references, "dictionary_of", lambda nominal: None)
    monkeypatch.setattr(references, "answers", named)
    study.refer("development", -1.0, None)
    assert asked == []
    study.refer("development", None, 3)
    study.refer("development", 60.0, None)
    assert asked == ["clean-02", "clean-00", "clean-01", "clean-03"]
    kept = answering.answered(tmp_path / "answers" / "development_sparse_regression.jsonl")
    assert set(kept) == set(names)
