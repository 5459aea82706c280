"""The screen of an identification says what to believe and what not."""

import io
import math
import re
from dataclasses import replace

import numpy as np
import pytest

from cpam_bayes.identification.warnings import point_warnings
from cpam_bayes.plate import builtin
from cpam_bayes.report.identification.words import noise_sentence, verdict_sentences
from cpam_bayes.report.plates.head import edges_text, plate_head
from cpam_bayes.report.tables import plain_text, screen_text


@pytest.fixture
def shown(result_of):
    """The screen of an estimate as a file gets it."""
    return lambda *args: screen_text(result_of(*args).tables(), io.StringIO())


def with_constant(result, **changes):
    """The result with its first constant changed."""
    return replace(result, constants=(replace(result.constants[0], **changes), *result.constants[1:]))


def with_measurement(result, **changes):
    measurement = replace(result.specimen.measurement, **changes)
    return replace(result, specimen=replace(result.specimen, measurement=measurement))


def test_the_screen_has_constants_frequencies_and_how_they_were_found(identification, shown):
    text = shown(identification)
    assert re.search(r"E1 +67\.\d+ +0\.\d\d +GPa +69 +10 to 200 +determined by the data", text)
    assert re.search(r"1 +\(1,1\) +bending +114 +113\.3 +-0\.6\d", text)
    assert "rms residual  1.0" in text
    assert re.search(r"solver +error about 0\.00\d+ % in the worst mode", text)
    assert re.search(rf"{identification.swarm.evaluations} forward solves in \d+\.\d s, seed 1", text)
    assert "  air       none given: vacuum, no air in the model; 1.2 kg/m3 would lower" in text
    assert "Table 3 also prints G12" in text
    assert "Warnings" not in text


def test_residuals_with_one_digit_keep_their_sign(identification, shown):
    text = shown(identification)
    signs = re.findall(r"bending +\d+ +\d+\.\d +([-+]?)\d+\.\d\d$", text, re.M)
    assert len(signs) == 6
    assert all(signs)


def test_a_constant_on_a_bound_is_the_bounds_doing(identification, shown):
    stuck = with_constant(identification, bound="upper", verdict="determined by data and prior", value=200e9)
    assert "E1 sits on its upper bound, 200 GPa: the bound decided" in shown(stuck)
    assert "at its upper bound" in shown(stuck)


def test_a_constant_that_is_not_determined_is_not_to_be_used(identification, shown):
    prior_sd = identification.specimen.unknowns["E1"].prior.sd
    loose = with_constant(identification, verdict="determined by the prior", sd=0.87 * prior_sd)
    assert "E1 is not determined by the frequencies: its sd is 87 % of that" in shown(loose)
    assert "Do not use its value" in shown(loose)
    assert verdict_sentences(loose)[-1] == "Determined by the frequencies: nu12."
    none = tuple(replace(c, verdict="determined by the prior") for c in identification.constants)
    said = verdict_sentences(replace(identification, constants=none))
    assert said[-1] == "Determined by the frequencies: none of the constants."


def test_without_spare_frequencies_there_are_no_standard_deviations(identification, shown):
    constants = tuple(
        replace(c, sd=math.nan, verdict="determined by the prior") for c in identification.constants
    )
    blind = replace(identification, noise=math.nan, constants=constants)
    text = shown(blind)
    assert "No standard deviations: 6 frequencies for 2 unknowns" in text
    assert re.search(r"E1 +67\.\d+ +- +GPa +69 +10 to 200 +sd not known", text)


def test_the_origin_of_the_noise_is_named(identification):
    inferred = noise_sentence(identification)
    assert "inferred from the residuals (6 frequencies less 2 unknowns: 4 left over)" in inferred
    assert "rounding to 1 Hz" in inferred
    given = with_measurement(identification, relative_std=0.005, resolution=0.0)
    sentence = noise_sentence(replace(given, noise=0.005, noise_is_inferred=False))
    assert sentence == "0.50 % of a frequency, from the plate file (relative_std)"


def test_a_solver_error_that_is_not_small_beside_the_noise_is_a_warning(identification):
    assert point_warnings(identification, "absolute") == ()
    coarse = replace(identification, noise=1e-4)
    assert "the solver's error is up to 0.00" in point_warnings(coarse, "absolute")[0]
    wrong = replace(identification, error=np.full(6, 0.066), noise=math.nan)
    assert "up to 6.6 % of a frequency" in point_warnings(wrong, "absolute")[0]


def test_a_swarm_that_used_its_budget_is_a_warning(identification, result_of):
    swarm = replace(identification.swarm, status="budget", message="the budget was used")
    assert point_warnings(replace(identification, swarm=swarm), "absolute") == ("the budget was used",)
    result = result_of(identification, ("the budget was used",))
    assert "  The budget was used." in result.summary()


def test_a_search_that_saw_another_misfit_than_the_plate_solver_is_a_warning(identification):
    swarm = replace(identification.swarm, value=6 * 5.0**2)
    (warning,) = point_warnings(replace(identification, swarm=swarm), "absolute")
    assert "rms misfit of 5.00 Hz at these constants, the full model has 2.05 Hz" in warning
    relative = replace(identification.swarm, value=6 * identification.rms**2)
    assert point_warnings(replace(identification, swarm=relative), "relative") == ()


@pytest.mark.parametrize(
    ("edges", "text"),
    [
        ("FFFF", "free on all four edges"),
        ("CFFF", "clamped at x = 0; free at y = 0, x = length and y = width"),
        ("SCSF", "simply supported at x = 0 and x = length; clamped at y = 0; free at y = width"),
    ],
)
def test_edges_are_said_in_words(edges, text):
    assert edges_text(edges) == text


def test_the_head_has_the_slips_of_print_of_a_specimen():
    text = plain_text(plate_head(builtin("C1"), None))
    assert "layup     [(0/90)_8]_s, 32 plies" in text
    assert re.search(r"note +Table 2 prints this layup as", text)
