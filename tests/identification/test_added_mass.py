"""A mass added to a plate: its shifts against complete models, and what lists reveal of it."""

from itertools import product

import numpy as np
import pytest

import cpam_bayes as cb
from cpam_bayes.forward_model.model import converged_model
from cpam_bayes.identification import added_mass
from cpam_bayes.identification.added_mass import Finding, Repeatability, cells_of, find_masses, symmetries
from cpam_bayes.parameters import Parameter, ParameterSet, Uniform
from tests.plate_file import described

N, NOISE, AREAL = 10, 0.002, 24.0
GLASS = {"E1_GPa": 40.0, "E2_GPa": 9.0, "nu12": 0.28, "G12_GPa": 4.0}
SIZE = (240.0, 160.0, 2.6)
MASS = 1900.0 * 0.24 * 0.16 * 0.0026


def plate_of(edges, **tables):
    return described(SIZE, 1900.0, GLASS, layup="[(0/90)_3]_s", edges=edges, **tables)


def loaded(edges):
    parameters = ParameterSet((Parameter("E1", "Pa", Uniform(20e9, 60e9)),))
    model = converged_model(cb.read_plate(plate_of(edges)), parameters, N)
    at = np.array([40e9])
    of = (0.24, 0.16), (MASS, 0.002)
    return added_mass.loaded_plate(model, at, at * [[0.99], [1.01]], np.arange(N), *of)


@pytest.fixture(scope="module")
def free():
    plate = loaded("FFFF")
    return plate, cells_of(plate)


def answer(plate, d, noise=NOISE, seed=0):
    relative = None if noise is None else np.full(N, noise)
    return find_masses(*plate, [(d, Repeatability(relative, np.zeros(N)))], np.random.default_rng(seed))[0]


def repeated(rng):
    return np.sqrt(2) * NOISE * rng.standard_normal(N)


def shifts_of_model(edges, mass, x, y):
    """Shifts of a complete model with the mass as nine points of a disc of 24 kg/m2 on its surface."""
    places = [(-0.75, 2.0 / 9.0), (0.0, 5.0 / 9.0), (0.75, 2.0 / 9.0)]  # second moments of a disc
    radius = 1e3 * np.sqrt(mass / (np.pi * AREAL))
    at = ((p * q, x + radius * i, y + radius * j) for (i, p), (j, q) in product(places, places))
    known = [{"mass_g": 1e3 * mass * part, "x_mm": u, "y_mm": v} for part, u, v in at]
    with_mass = cb.forward(plate_of(edges, sensor=known), N).frequencies
    return np.log(with_mass / cb.forward(plate_of(edges), N).frequencies)


@pytest.mark.slow
@pytest.mark.parametrize("edges", ["FFFF", "CFFF"])
@pytest.mark.parametrize("fraction", [0.01, 0.08])
def test_shifts_in_the_modes_are_those_of_a_model_that_holds_the_mass(edges, fraction):
    exact, mass = shifts_of_model(edges, fraction * MASS, 60.0, 35.0), np.array([fraction * MASS])
    found = loaded(edges).shifts(np.array([[60 / 240, 35 / 160]]), mass, [AREAL])[0, 0, 0]
    assert np.abs(found - exact).max() < 0.02 * np.abs(exact).max()  # the form error is 2 % of a shift


@pytest.mark.slow
def test_a_mass_up_to_the_largest_is_found_where_it_is(free):
    mass, x, y = 0.03 * MASS, 60.0, 35.0
    found = answer(free, shifts_of_model("FFFF", mass, x, y))
    assert found.finding is Finding.ADDED
    assert found.interval[0] < mass < found.interval[1]
    assert len(found.images) == 3  # the four corners of a free cross-ply plate are equivalent
    assert found.distance(1e-3 * x, 1e-3 * y) < 0.5 * found.radius < 0.01
    d = shifts_of_model("FFFF", 0.04 * MASS, x, y)  # an unstated repeatability is inferred
    found = answer(free, d + repeated(np.random.default_rng(3)), noise=None)
    assert found.finding is Finding.ADDED
    assert NOISE / 3 < found.noise < 3 * NOISE
    d = shifts_of_model("FFFF", 0.22 * MASS, x, y)  # a mass above the limit counts as none found
    for noise in (NOISE, None):
        assert answer(free, d, noise=noise).finding is Finding.OTHER
    clamped = loaded("CFFF")
    assert len(symmetries(clamped, cells_of(clamped))) == 2, "a clamp takes one mirror image away"


def test_known_masses_show_repeatability_and_error_of_a_shift():
    """95 and 90 % binomially: for 200 laboratories with four coins that share a first list."""
    rng = np.random.default_rng(8)
    shifts, inside, below = 0.02 * rng.uniform(size=(200, 4, N)), 0, 0
    for shift in shifts:
        noise, form = 0.002 * rng.standard_normal((5, N)), 0.1 * shift * rng.standard_normal(shift.shape)
        (low, high), bound = added_mass.spread_of_shifts(noise[1:] - noise[0] + form, shift, np.zeros(N))
        inside, below = inside + (low < 0.002 < high), below + (bound > 0.1)
    assert 180 <= inside <= 199
    assert below >= 180


@pytest.mark.slow
def test_no_mass_is_claimed_of_repeats(free):
    rng = np.random.default_rng(1)
    repeats = [answer(free, repeated(rng)).finding for _ in range(12)]
    assert repeats.count(Finding.ADDED) <= 1
    assert repeats.count(Finding.NOTHING) >= 8
    for factor in (0.01, -0.01, -0.005):  # if all rise, or fall as in a warmer room, that is no mass
        noisy = factor + repeated(rng)
        assert answer(free, noisy).finding is Finding.OTHER
        assert answer(free, noisy, noise=None).finding in (Finding.OTHER, Finding.OPEN)


@pytest.mark.slow
@pytest.mark.weekly
def test_lists_tell_each_other_the_repeatability_that_no_file_states(free):
    d, rng = shifts_of_model("FFFF", 0.03 * MASS, 60.0, 35.0), np.random.default_rng(4)
    shared = NOISE * rng.standard_normal(N)
    lists = [on + NOISE * rng.standard_normal(N) - shared for on in (d, 0.0 * d, 0.0 * d)]
    unstated, alone = Repeatability(None, np.zeros(N)), answer(free, lists[0], noise=None)
    together = find_masses(*free, [(one, unstated) for one in lists], rng)
    assert together[0].log_bayes_factor > alone.log_bayes_factor + 4.0
    # two standard deviations of a scatter estimated from about 25 independent differences
    assert abs(np.log(together[0].noise / NOISE)) < 2.0 / np.sqrt(2 * 25)
    assert together[0].interval[0] < 0.03 * MASS < together[0].interval[1]
    assert all(one.finding is Finding.NOTHING for one in together[1:])


@pytest.mark.slow
@pytest.mark.weekly
def test_a_mass_at_the_detection_limit_is_mostly_claimed_and_a_tenth_of_it_less_often(free):
    rng = np.random.default_rng(2)
    limit = added_mass.detection_limit(*free, NOISE, np.zeros(N), rng)

    def claimed(mass):
        count = 0
        for _ in range(8):
            d = free[0].shifts(rng.uniform(0.0, 0.15, (1, 2)), np.array([mass]), [AREAL])[0, 0, 0]
            count += answer(free, d + repeated(rng)).finding is Finding.ADDED
        return count

    assert claimed(limit) >= 7  # near a corner, where a mass shows best
    assert claimed(0.1 * limit) <= 3
