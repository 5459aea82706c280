"""Layups one step from the stated one: which there are, and what plates laid up so do."""

import pickle
from dataclasses import replace

import numpy as np
import pytest

import cpam_bayes as cb
from cpam_bayes.diagnosis.hypotheses import prior_by_cause, single_hypotheses
from cpam_bayes.diagnosis.models import extended_model, plate_models
from cpam_bayes.effects import Effect, PlateFacts, extend, variants
from cpam_bayes.effects.layup import LAYUP, MOST, neighbours
from cpam_bayes.forward_model.model import plate_problem
from cpam_bayes.forward_model.reduced import basis_error
from cpam_bayes.mechanics.dense import MATRICES
from cpam_bayes.mechanics.problem import Problem
from cpam_bayes.plate.layup import from_angles, parse_layup
from cpam_bayes.plate.reader import builtin
from tests.effects.cases import facts, facts_of
from tests.hybrids import hybrid
from tests.plates import CARBON, frequencies, plate, with_plate

PLY = CARBON | {"G13": 5.1e9, "G23": 3.0e9}


def steps(text: str) -> dict[str, tuple[float, ...]]:
    """The layup that each step gives."""
    layup = parse_layup(text)
    return {s.text: tuple(layup.angles_deg[s.order(layup.n_plies)].tolist()) for s in neighbours(layup)}


def form(of: PlateFacts, text: str) -> Effect:
    return next(e for e in variants(LAYUP, of) if e.variant == text)


def test_neighbours_of_short_layups_are_those_found_by_hand() -> None:
    assert steps("[0/90/0]") == {
        "ply 1 missing": (90.0, 0.0),  # turned over it is the one without the third
        "ply 2 missing": (0.0, 0.0),
        "plies 1 and 3 missing": (90.0,),
        "plies 1 and 2 exchanged": (90.0, 0.0, 0.0),
    }
    # exchanged, it is the same plate turned over
    assert steps("[0/90]") == {"ply 1 missing": (90.0,), "ply 2 missing": (0.0,)}
    assert steps("[0/90]_s") == {
        "ply 1 missing": (90.0, 90.0, 0.0),
        "ply 2 missing": (0.0, 90.0, 0.0),
        "plies 1 and 4 missing": (90.0, 90.0),
        "plies 2 and 3 missing": (0.0, 0.0),
        "plies 1 and 2 exchanged": (90.0, 0.0, 90.0, 0.0),
        "plies 1 and 2, 3 and 4 exchanged": (90.0, 0.0, 0.0, 90.0),
    }
    # the upper half is no image of the lower: its steps are others
    assert set(steps("[0/90/45]")) == {
        *("ply 1 missing", "ply 2 missing", "ply 3 missing"),
        *("plies 1 and 2 exchanged", "plies 2 and 3 exchanged"),
    }


def test_a_long_layup_has_those_neighbours_whose_bending_differs_most() -> None:
    layup = parse_layup("[(0/90)_8]_s")
    every = neighbours(layup, 1000)
    assert len(every) > len(neighbours(layup)) == MOST
    assert neighbours(layup) == every[:MOST]
    # the outermost plies carry most, those at the midplane next to nothing
    assert every[0].text == "plies 1 and 32 missing"
    assert {i for s in every[-8:] for i in (*s.missing, *s.exchanged)} <= set(range(10, 22))


def test_plates_of_one_material_direction_and_of_unknown_angles_do_not_have_it() -> None:
    of = facts("C1")
    assert LAYUP.applies_to(of)
    for other in (
        replace(of, isotropic=True),
        replace(of, layup=parse_layup("[30_8]")),
        replace(of, layup=parse_layup("[?/?]_s")),
    ):
        assert not LAYUP.applies_to(other)


def test_all_forms_are_equally_probable_and_together_as_much_as_another_cause_of_the_layup() -> None:
    found = single_hypotheses(facts("C1"), 8, complete=True)
    forms = [h for h in found if h.cause == "layup"]
    assert len(forms) == len(neighbours(facts("C1").layup))
    assert len({h.prior for h in forms}) == 1
    prior = prior_by_cause(found)
    assert prior["layup"] == pytest.approx(prior["misorientation"], rel=1e-12)


@pytest.mark.parametrize(
    ("stated", "text"),
    [
        ("[(0/90)_2]_s", "plies 2 and 7 missing"),
        ("[(0/90)_2]_s", "plies 1 and 2, 7 and 8 exchanged"),
        ("[0/45/-45/90]_s", "plies 1 and 2, 7 and 8 exchanged"),
        # the space of an unsymmetric plate couples stretching with bending
        ("[0/90/45]", "ply 2 missing"),
        ("[0/90/45]", "plies 1 and 2 exchanged"),
    ],
)
def test_a_form_is_the_plate_read_with_that_layup(stated: str, text: str) -> None:
    specimen = with_plate("C1", layup=parse_layup(stated))
    of = PlateFacts.of(specimen.plate, isotropic=False)
    found = pickle.loads(pickle.dumps(extend(plate_problem(specimen), form(of, text), of)))
    read = with_plate("C1", layup=from_angles(steps(stated)[text]))
    expected = plate_problem(read)
    for kind in MATRICES:
        c = expected.coefficients({}, kind)
        np.testing.assert_allclose(found.coefficients({}, kind), c, rtol=0, atol=1e-12 * np.abs(c).max())
        assert found.forms(kind) == expected.forms(kind)


def test_plies_of_a_hybrid_keep_their_materials_and_the_plate_its_thickness_and_mass() -> None:
    specimen = cb.read_plate(hybrid())
    layup = specimen.plate.layup
    of = PlateFacts.of(specimen.plate, isotropic=False)
    for step, own in zip(neighbours(layup), variants(LAYUP, of), strict=True):
        order = step.order(layup.n_plies)
        kinds = tuple(layup.kinds[i] for i in order)
        read = replace(from_angles(layup.angles_deg[order].tolist()), kinds=kinds)
        if not read.is_symmetric:
            continue
        state = extend(plate_problem(specimen), own, of).state({})
        expected = plate_problem(replace(specimen, plate=replace(specimen.plate, layup=read))).nominal
        k = expected.stiffness()
        np.testing.assert_allclose(state.stiffness(), k, rtol=0, atol=1e-12 * k.max())
        assert (state.thickness, state.density) == (specimen.plate.thickness, specimen.plate.density)
        assert state.plies is not None
        assert expected.plies is not None
        np.testing.assert_allclose(state.plies.mass_moments, expected.plies.mass_moments, atol=1e-12)


@pytest.mark.parametrize(
    ("stated", "edges", "most"),
    [
        ("[(0/90)_4]_s", "CFFF", 1e-3),
        ("[0/90/0]", "FFFF", 0.04),
        pytest.param("[0/45/-45/90]_s", "FFFF", 0.07, marks=pytest.mark.slow),
        pytest.param("[0/60/-60]_s", "FFFF", 0.13, marks=pytest.mark.slow),
    ],
)
def test_reduced_bending_errs_by_a_small_part_of_the_shift_on_an_unsymmetric_neighbour(
    stated: str, edges: str, most: float
) -> None:
    """The coupled plate, on a space with functions for stretching, is what it is compared with."""

    def laid_up(angles: tuple[float, ...]) -> Problem:
        return plate(0.26, 0.2, 2e-3, 1600.0, PLY, angles, edges)

    stated_angles = tuple(parse_layup(stated).angles_deg.tolist())
    problem = laid_up(stated_angles)
    of = facts_of(problem, stated_angles)
    unsymmetric = [text for text, angles in steps(stated).items() if angles != angles[::-1]][:3]
    bare = frequencies(problem, 6)
    for text in unsymmetric:
        coupled = frequencies(laid_up(steps(stated)[text]), 6)
        reduced = frequencies(extend(problem, form(of, text), of), 6)
        error, shift = (np.abs(f / coupled - 1.0).max() for f in (reduced, bare))
        assert error < most * shift, text


def test_all_forms_of_a_plate_are_one_reduced_model_that_is_built_once() -> None:
    models, built = plate_models(builtin("C1"), 6), list[str]()
    rng = np.random.default_rng(0)
    for own in variants(LAYUP, models.facts)[::12]:
        reduced = extended_model(models, own, built.append)
        x = reduced.parameters.sample(rng, 40)
        x = x[reduced.admissible(x)][:4]
        assert reduced.parameters == models.bare.parameters
        # twice the tolerance that a basis is made to, at sets that it has not seen
        assert basis_error(reduced, x).max() < 2.0 * models.bare.tolerance  # type: ignore[arg-type]
        moved = reduced.predict(x, jacobian=True)
        plain = models.bare.predict(x, jacobian=True)
        assert not np.allclose(moved.frequencies, plain.frequencies, rtol=1e-3)
        step = 1e-5 * x[:1]
        for j in range(x.shape[1]):
            at = np.repeat(x[:1], 2, axis=0)
            at[:, j] += np.array([1.0, -1.0]) * step[0, j]
            f = reduced.predict(at).frequencies
            np.testing.assert_allclose(
                moved.jacobian[0, :, j] * x[0, j], (f[0] - f[1]) / 2e-5, rtol=1e-4, atol=1e-4 * f.max()
            )
    assert built == ["building layup"]
