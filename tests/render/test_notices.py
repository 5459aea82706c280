"""Every notice of the package has a sentence made from its facts."""

import ast
import re
from pathlib import Path

import pytest

import cpam_bayes
from cpam_bayes.answer import Notice, as_written, each_once
from cpam_bayes.plate import Constraint
from cpam_bayes.render.notices import SENTENCES, capitalised, sentence_of, sentences

MAKERS = {"Notice", "cut_short"}


def test_every_code_has_a_sentence_and_every_sentence_a_code():
    """Codes are the first arguments of the calls that make notices."""
    codes = set()
    for path in Path(cpam_bayes.__file__).parent.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            makes = isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in MAKERS
            if makes and isinstance(node.args[0], ast.Constant):
                codes.add(node.args[0].value)
    assert codes == set(SENTENCES)


CUT = Constraint("E1 > E2, fourth of eq. (9)", "transversely_isotropic", "c")
PLACE = {"level": 0.01, "reading": "rms", "noise_sd": 2.5}
GAUGED = {"gauged": (3.1e-3, 2e-5)}
SWAPPED = {"swapped": {"plate": "", "frequency": 3, "modes": ("(1,1)", "(2,0)")}}
FACTS: dict[str, dict[str, object]] = {
    "as_written": {"text": "two rows are equal"},
    "units": {"ratio": 985.0, "median": 985.0, "weighed": False},
    "reference_outside": {"outside": (("E1", 2e11, 1e10, 1e11),)},
    "few_frequencies": {"frequencies": 1, "unknowns": 2}, "no_frequency_over": {"count": 2},
    "large_stated_noise": {"noise": 0.2},
    "thicknesses_apart": {**GAUGED, "by_mass": (3.26e-3, 3.4e-5), "apart": 4.1, "taken": (3.14e-3, 7e-5)},
    "equal_lists": {"plates": ("a", "b"), "apart": 0.0},
    "list_given_twice": {"name": "b.csv", "before": "a.csv"}, "axes_exchange": {"square": True},
    "prior_not_fitted": {"names": ("E1",)}, "prior_not_inverted": {"names": ("E1", "nu12")},
    "sizes_exact": {"names": ("thickness",)}, "shape_without_mode": {"frequency": 152.317, "assurance": 0.3},
    "shapes_of_several": {"shapes": ((152.317, (("(1,1)", 0.6), ("(2,0)", 0.4))),), "use": "best"},
    "label_without_mode": {"labels": (("(9,9)", 152.317),), "modes": 6},
    "other_label": {"frequency": 1, "given": "(1,1)", "found": "(2,0)"},
    "doubtful_list": {"missed": ("(2,0)", 311.2), "spurious": None, "log_odds": 5.0},
    "large_misfit": {"misfit": 0.05, "slips": (("clamped", 0, 0.0, "FCFF"),), "fit": 0.002},
    "misfit_over_noise": {"times": 3.4}, "high_noise": {"noise": 0.022},
    "far_reference": {"distances": (("E1", -8.4), ("G12", 5.8))},
    "common_factor": {"distances": (("E1", -4.0),), "ratio": 0.5, "thickness": 3.2e-3, "weighed": False},
    "search_model": {"reduced": 5.0, "full": 2.05, "relative": False},
    "poor_fit": {"mode": 3, "residual": 0.08}, "optimum_on_constraint": {"constraint": CUT},
    "cut_posterior": {"constraint": CUT}, "solver_error": {"error": 0.066, "mode": 6},
    "soft_core": {"error": 0.3, "limit": 0.1}, "narrow_basis": {"fraction": 0.62},
    "chains_not_converged": {"steps": 20, "r_hat": 1.2, "ess_bulk": 12.0},
    "unexplained_residuals": {"p": 0.01}, "unexplained_by_none": {"p": 0.01, "inferred": True},
    "unexplained_by_claim": {"p": 0.01}, "single_frequencies": {"stable": 0.5},
    "several_optima": {"count": 2, "fractions": (0.6, 0.4), "constant": "E1", "apart": 0.05, **SWAPPED},
    "differing_priors": {"names": ("E1",), "taken": "a"}, "rough_evidences": {"error": 0.4},
    "unweighed_sets": {"probability": 0.3}, "rough_surrogate": {"rms": 0.4},
    "overlooked_sequence": {"better": 1.2}, "sequences_left_out": {"probability": 0.01},
    "uncertain_evidences": {"count": 2, "error": 0.4, "first": 3},
    "no_sequence_explains": {"p": 1e-4, "complete": True},
    "frequencies_without_mode": {"alone": 1, "of": 6, "complete": False},
    "sequence_noise": {"noise": 0.06, "complete": True}, "sequence_at_bounds": {"bounds": (("E1", "upper"),)},
    "at_bound": {"bounds": (("E1", "upper", 62e9), ("nu12", "lower", 0.2))},
    "sequence_chains": {"number": None, "r_hat": 1.2, "ess_bulk": 12.0},
    "sequence_disagrees": {"number": 2, "z": 6.0},
    "one_layup_taken": {"angles_deg": (0.0, 45.0), "probability": 0.4},
    "misfit_beside_noise": {"misfit": 0.02, "level": 0.01}, "constants_not_found_again": {"names": ("E1",)},
    "swarms_in_worse_optima": {"found": 4, "of": 10}, "inversions_missed": {**PLACE, "count": 2, "of": 10},
    "noise_chains": {**PLACE, "ess_bulk": 12.0}, "noise_posterior_cut": {**PLACE, "constraint": CUT},
    "noise_swarms": {**PLACE, "count": 2, "of": 10}, "noise_redrawn": {**PLACE, "count": 3},
    "unconverged_tasks": {"titles": ("C1",)}, "tasks_of_one_swarm": {"titles": ("C1",)},
    "failed_plates": {"count": 1}, "list_over_noise": {"plate": "C1", "times": 3.2},
    "prior_of_former_plate": {"plates": ("a",)}, "disagreeing_plates": {"plates": tuple("abcdefg")},
    "undescribed_plates": {"plates": tuple((f"p{i}", 3.0) for i in range(10))},
    "no_population": {"reason": "two plates are needed"},
    "population_chains": {"steps": 20, "r_hat": 1.2, "ess_bulk": 12.0},
    "other_sizes": {"plate": "C1", "sizes": (("length", 0.15, 0.2),)},
    "other_constants": {"constants": (("nu12", 0.3, 0.33),)}, "hum": {"mains": 50.0, "size": 0.2},
    "modes_beyond_range": {"frequency": 412.0}, "largest_below_range": {"frequency": 8.0},
    "no_poles": {"range": (10.0, 400.0), "peaks": (50.0,)}, "peaks_without_pole": {"peaks": (250.0,)},
    "close_poles": {"pairs": ((100.0, 100.4),)}, "poor_poles": {"frequencies": (100.0,), "limit": 0.01},
    "drifting_modes": {"frequencies": (100.0,), "limit": 0.005}, "unlike_hit": {"hit": 3, "shift": -0.004},
    "hits_apart": {"hits": (2, 5), "of": 5}, "double_hits": {"hits": (1, 3), "of": 3},
    "short_hits": {"short": (("hit_1.wav", 1.42, 0.08),)}, "left_out_peaks": {"peaks": (430.4,)},
    "ringing_sensor": {"channel": 2, "frequency": 8300.0, "share": 0.93},
    "clipped_files": {"files": ("h1.wav",)}, "repeated_files": {"files": ("h1.wav",)},
    "silent_channels": {"channels": (2,)},
    "time_up": {"seconds": 3.0, "missing": (("cut_gain", {}), ("cut_swarms", {"done": 1, "of": 3}))},
    "cut_swarm": {"done": 0, "of": 400}, "cut_swarms": {"done": 1, "of": 3},
    "cut_chains": {"done": 20, "of": 1000}, "cut_hypotheses": {"count": 2, "causes": ("air", "support")},
    "cut_groups": {"done": 2, "of": 4}, "cut_plates": {"late": 2, "of": 3},
    "cut_tasks": {"late": 2, "of": 3}, "cut_sequences": {"done": 2, "of": 20},
}  # fmt: skip


@pytest.mark.parametrize("code", SENTENCES)
def test_a_sentence_is_short_and_complete(code):
    said = sentence_of(Notice(code, facts=FACTS.get(code, {})))
    assert not re.search(r"[{}]|nan|None|  ", said)
    assert len(said.split()) <= 60
    if not code.startswith("cut_") or code == "cut_posterior":
        assert (said[-1], said) == (".", capitalised(said))


def test_numbers_and_cures_are_in_the_sentences_of_which_each_is_told_once():
    for code, said in {
        "common_factor": ("2.26 mm instead of 3.2 mm", "density 2.00 times", "0.707 times too high"),
        "large_stated_noise": ("repeatability, 0.2, is 20 %", "write 0.002"),
        "cut_posterior": ("fourth of eq. (9) of c", "orthotropic model"),
        "doubtful_list": ("(2,0) near 311.2 Hz", "148 times", "modes may be missing"),
        "disagreeing_plates": ("a, b, c, d, e and 2 more disagree",),
        "sizes_exact": ("thickness_mm is assumed exact here: its stated",),
        "population_chains": ("did not converge in 20 steps",),
        "undescribed_plates": ("p4 (3.0 times the noise) and 5 more",),
        "time_up": ("3 s", "detection limits were computed; 1 of at least 3 swarms ran."),
    }.items():
        sentence = sentence_of(Notice(code, facts=FACTS[code]))
        assert all(part in sentence for part in said)
    both = Notice("sizes_exact", facts={"names": ("thickness", "length")})
    assert "thickness_mm and length_mm are assumed exact here: their stated" in sentence_of(both)
    few, other = Notice("failed_plates", facts={"count": 1}), Notice("mixed_materials", "remark")
    assert each_once((few, other, Notice("failed_plates", facts={"count": 1}))) == (few, other)
    assert sentences((few, other, few), "slip", "warning") == (sentence_of(few),)
    assert sentences((*as_written(("it is so",)), few))[0] == "It is so."
