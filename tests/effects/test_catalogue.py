"""The contract of an effect, over the whole catalogue and both discretisations."""

import ast
import json
import pickle
from dataclasses import replace
from functools import cache, lru_cache, partial
from itertools import combinations, product
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import cpam_bayes
from cpam_bayes.diagnosis.hypotheses import Claim
from cpam_bayes.effects import CATALOGUE, Effect, applicable, extend, scale_of, variants
from cpam_bayes.effects.table import BEGIN, END, catalogue_table
from cpam_bayes.forward_model.model import SIZES, PlateModel, constant_parameters, plate_problem
from cpam_bayes.mechanics.affine import AffineOperator
from cpam_bayes.mechanics.dense import MATRICES
from cpam_bayes.mechanics.problem import PlateState, StateFunction, Values
from cpam_bayes.parameters import Mixture, ScaledStudentT
from cpam_bayes.plate import Measurement
from cpam_bayes.plate.edges import conditions
from cpam_bayes.plate.laminate import laminate_geometry
from cpam_bayes.plate.layup import Layup
from cpam_bayes.plate.reader import builtin, builtin_names
from cpam_bayes.questions.diagnose import diagnose
from tests.effects.cases import (
    BY_NAME,
    MODES,
    SUPPORTED,
    bare,
    elements,
    facts,
    of_plate,
    placed,
    ritz,
    ritz_operator,
    values_at,
    with_effect,
)

PAGE = (Path(__file__).parents[2] / "docs" / "effects.md").read_text(encoding="utf-8")
# Largest shift of a frequency at 1 sd, %, of the first 6, 6 and 10 modes of C1, A2 and D3. A mass lies at
# (0.95, 0.95), a strip along x = length, a smooth damage of extent 0.05 at the centre.
LARGEST_SHIFTS = """
clamp_rotation          -   -3.8   -3.8
clamp_translation       -   -6.1  -23.7
clamp_slip              -  -0.03  -0.04
clamp_length            -   -0.4   -0.8
sensor_mass          -2.6   -3.8   -2.9
edge_mass           -0.58  -0.63  -0.62
support              +0.3      -      -
air                 -0.63  -0.69  -0.32
thickness              20     20     20
density              -8.7   -8.7   -8.7
length               -7.3   -9.4   -9.3
width                -9.2   -4.2   -8.9
frequency_scale       2.0    2.0    2.0
taper_x             -0.09   -3.6   -3.6
taper_y             -0.11   0.03  -0.16
skew                 0.27  -0.05   0.04
misorientation       0.12      -   0.18
outer_ply_angle       0.7      -   0.27
inner_ply_angle      0.14      -   0.12
warp                 0.87   2.07   2.69
membrane_stress      0.92   0.20   0.06
transverse_shear     0.14   0.09   0.99
shear_ratio          0.04      -   0.32
damage               -0.4   -0.3   -0.2
resin_skin           -6.9      -   -6.3
viscoelastic          0.6    0.8    1.1
"""
EXPECTED = {cells[0]: cells[1:] for cells in map(str.split, LARGEST_SHIFTS.strip().splitlines())}
# Names of the contract: answers, stores and studies hold them.
KEPT_NAMES = {
    *EXPECTED,
    *("soft_clamp", "soft_support", "mode_identity", "outlier", "material", "layup", "swapped_sides"),
}
ON_THE_PLATE = [e for e in CATALOGUE if e.change or e.observe]
OF_THE_PROBLEM = [e for e in CATALOGUE if e.change is not None]
MEMBRANE = ("u", "v")
# Many forms, small elements or a dense matrix.
LONG = ("air", "damage", "clamp_slip", "warp", "taper_x", "taper_y", "outline")


def cases(effects: list[Effect]) -> list[object]:
    return [
        pytest.param(plate, effect, id=f"{plate}-{effect.name}")
        for effect in effects
        for plate in plates_with(effect)
    ]


def plates_with(effect: Effect) -> list[str]:
    """Those of the page's plates that can have the effect, or the supported one if none can."""
    return [plate for plate in MODES if effect.applies_to(facts(plate))] or [SUPPORTED]


def first_plate(effect: Effect) -> str:
    """A plate that can have the effect: free where it may be, else the thick cantilever."""
    first, *_, last = plates_with(effect) * 2
    return first if first == "C1" else last


PAIRS = [(plate, placed(of_plate(plate, e))) for e in OF_THE_PROBLEM for plate in plates_with(e)]


one_plate = [
    pytest.param(first_plate(e), placed(of_plate(first_plate(e), e)), id=e.name) for e in OF_THE_PROBLEM
]
every_effect = pytest.mark.parametrize("effect", CATALOGUE, ids=lambda e: e.name)


@lru_cache
def shifts(plate: str, effect: Effect) -> np.ndarray:
    """Relative shifts at one standard deviation of the catalogue and at minus one, (2, n_modes), %."""
    f = ritz(plate, placed(of_plate(plate, effect)), (0.0, 1.0, -1.0 if two_sided(effect) else 1.0))
    return 100 * (f[1:] / f[0] - 1)


def two_sided(effect: Effect) -> bool:
    return effect.parameters[0].prior.lower < 0


# The records


def test_names_of_causes_and_of_parameters_are_unique_and_those_of_the_contract_stay() -> None:
    names = [effect.name for effect in CATALOGUE]
    assert set(names) >= KEPT_NAMES
    for each in (names, [p.name for effect in CATALOGUE for p in effect.parameters]):
        assert len(set(each)) == len(each)


@every_effect
def test_the_null_is_possible_and_sizes_are_shown_in_units_with_priors_of_student_t(effect: Effect) -> None:
    for p in effect.coordinates:
        assert p.prior.lower < scale_of(p) == p.null < p.prior.upper, p.name
    for p in effect.sizes:
        assert p.null == 0.0
        assert p.prior.lower <= 0.0 < scale_of(p) < p.prior.upper, p.name
        unit, factor = p.display
        # what is shown in SI says so by its unit, or is a number
        assert factor == 1.0 or unit != p.unit
        assert 1e-3 <= factor * scale_of(p) <= 1e6, p.name
        if isinstance(p.prior, Mixture):
            assert p.prior.fraction == 0.1
            assert p.prior.wide.sd >= 1.3 * p.prior.narrow.sd
            assert max(p.prior.upper, -p.prior.lower) > 4.0 * scale_of(p)
        if effect.name in ("air", "outline"):  # known; of a square that holds it, any part alike
            continue
        tolerance = p.prior.parts[0][1]
        assert isinstance(tolerance, ScaledStudentT)
        assert tolerance.degrees_of_freedom == 4.0
        if effect.name in ("transverse_shear", "shear_ratio"):  # within a factor of two
            continue
        # the cut takes off less than 4 % of the tails, which have to hold what is far off
        whole = ScaledStudentT(tolerance.scale, 4.0, min(p.prior.lower, 0.0) * 1e6, 1e6 * p.prior.upper)
        assert tolerance.log_density(0.0) - whole.log_density(0.0) < 0.04, p.name


@every_effect
def test_an_effect_says_what_it_acts_on_and_how_it_enters(effect: Effect) -> None:
    acts = (effect.change, effect.observe, effect.pairings, effect.drops_references or None, effect.on_plate)
    assert sum(act is not None for act in acts) == 1
    assert effect.parameters or effect.change is effect.observe is None
    assert effect.name.isidentifier()
    assert effect.title
    assert effect.note
    assert effect.check.endswith(".")
    for complete in (True, False):
        found = effect.pairings(7, complete) if effect.pairings else ()
        assert sum(v.fraction for v in found) == (pytest.approx(1.0) if found else 0)
        assert len({v.text for v in found}) == len(found)


def test_what_the_catalogue_says_of_causes_is_listed() -> None:
    # what nobody mistypes or mislays has no gross part, and what is a gross error alone is no mixture
    without = {e.name for e in CATALOGUE for p in e.sizes if not isinstance(p.prior, Mixture)}
    physics = {"transverse_shear", "shear_ratio", "membrane_stress", "viscoelastic", "resin_skin", "air"}
    misstated = {"thickness", "density", "length", "width", "frequency_scale", "outlier"}
    assert without == physics | misstated | {
        *("sensor_mass", "edge_mass", "damage", "clamp_slip", "support", "outline")
    }
    # a sister plate has what is of the material and of the laboratory
    assert {e.name for e in ON_THE_PLATE if e.is_common_to_sisters} == {
        *("air", "frequency_scale", "shear_ratio", "transverse_shear", "viscoelastic")
    }
    assert {e.name for e in CATALOGUE if e.belongs_to == "test"} == {
        *("clamp_rotation", "clamp_translation", "soft_clamp", "clamp_slip", "clamp_length"),
        *("mode_identity", "outlier", "soft_support"),
    }
    # compliances of one clamp exclude each other and no others do
    ways = ("clamp_rotation", "clamp_translation", "soft_clamp", "clamp_slip")
    apart = {frozenset((a.name, b.name)) for a, b in combinations(CATALOGUE, 2) if not a.goes_with(b)}
    assert apart == {frozenset(p) for p in combinations(ways, 2)}
    assert all(a.goes_with(b) == b.goes_with(a) for a, b in combinations(CATALOGUE, 2))


def test_the_expected_size_may_depend_on_the_plate() -> None:
    (found,) = variants(BY_NAME["warp"], facts("C1"))
    (prior,) = (p.prior for p in found.sizes)
    h = facts("C1").thickness
    np.testing.assert_allclose([prior.lower, prior.upper], [-4.0 * h, 4.0 * h])
    assert found.scaled(1.0)["sag"] == pytest.approx(0.25 * h)
    (skin,) = variants(BY_NAME["resin_skin"], facts("C1"))
    assert skin.parameters[0].prior.upper == pytest.approx(h / 5.0)
    for support in variants(BY_NAME["support"], replace(facts("C1"), first_frequency=120.0)):
        assert support.scaled(1.0)["support_frequency"] == pytest.approx(12.0)
        assert support.parameters[0].prior.upper == pytest.approx(60.0)
    for measured, expected in (
        (None, 0.01),
        (0.004, 0.004),
        (0.03, 0.01),
        (0.0, 1e-4),
    ):  # all losses, not the plate's alone
        (loss,) = variants(BY_NAME["viscoelastic"], replace(facts("C1"), loss_factor=measured))
        assert loss.scaled(1.0)["loss_tangent"] == pytest.approx(expected)
        assert loss.parameters[0].prior.upper == pytest.approx(5.0 * expected)
    smooth, sharp = variants(replace(BY_NAME["damage"], size_factor=lambda facts: 0.5), facts("C1"))
    assert smooth.scaled(1.0)["damage"] == 0.1
    assert (smooth.local, sharp.local) == ("bell", "rectangle")
    assert smooth.coordinates == sharp.coordinates


def test_effects_that_a_plate_cannot_have_or_have_no_place_yet_are_refused() -> None:
    assert {e.name for e in CATALOGUE} - {e.name for e in applicable(facts("C1"))} == {
        *("clamp_rotation", "clamp_translation", "soft_clamp", "clamp_slip", "clamp_length", "material"),
        *("soft_support", "swapped_sides"),
    }
    assert {e.name for e in CATALOGUE} - {e.name for e in applicable(facts("A2"))} == {
        *("support", "misorientation", "outer_ply_angle", "inner_ply_angle", "shear_ratio", "resin_skin"),
        *("layup", "material", "soft_support"),
    }
    for name, said in (
        ("clamp_slip", "clamp_slip: not possible on a plate with edges FFFF"),
        ("mode_identity", "mode_identity acts on the pairing"),
        ("sensor_mass", "fix its place with effect.at"),
        ("layup", r"layup: take one of its forms, variants\(effect, facts\)"),
    ):
        with pytest.raises(ValueError, match=said):
            extend(bare("C1"), BY_NAME[name], facts("C1"))
    assert variants(BY_NAME["skew"], facts("C1")) == (BY_NAME["skew"],)


# The null


@pytest.mark.parametrize(("plate", "effect"), cases(ON_THE_PLATE))
def test_null_gives_back_the_bare_plate(plate: str, effect: Effect) -> None:
    effect = placed(of_plate(plate, effect))
    sprung = effect.change is not None and any(e.sprung for e in conditions(with_effect(plate, effect).edges))
    degree = 7 if sprung else 9
    found = ritz(plate, effect, (0.0, 1.0), degree=degree)[0]
    expected = ritz(plate, None, degree=degree)[0]
    # blocks that an effect joins are solved with other rounding, 1e-8 to 1e-6 of a low frequency; a rigid
    # clamp is a stiff spring, which may lower a frequency by 1e-4, and rounds the more the higher the degree
    np.testing.assert_allclose(found, expected, rtol=1e-4 if sprung else 2e-6)


# The matrices


@pytest.mark.parametrize(("plate", "effect"), one_plate)
def test_forms_are_symmetric_mass_definite_and_stiffness_semidefinite_within_the_prior(
    plate: str, effect: Effect
) -> None:
    values = {
        p.name: np.array([p.prior.lower, scale_of(p), p.prior.upper])
        for variant in variants(effect, facts(plate))[:1]
        for p in variant.parameters
    }
    operator = ritz_operator(with_effect(plate, effect), values, 6)
    found = [np.atleast_2d(c) for c in operator.coefficients(values)]
    k, m = (np.broadcast_to(c, (3, c.shape[-1])) for c in found)
    for block in (each.dense() for each in operator.blocks):
        for form in (*block.stiffness.stack, *block.mass.stack):
            np.testing.assert_allclose(form, form.T, rtol=0, atol=1e-12 * np.abs(form).max())
        mass, stiffness = block.mass.assemble(m), block.stiffness.assemble(k)
        scale = 1 / np.sqrt(np.diagonal(mass, axis1=1, axis2=2))
        both = [x * scale[:, :, None] * scale[:, None, :] for x in (mass, stiffness)]
        assert np.linalg.eigvalsh(both[0]).min() > 1e-6
        lam = np.linalg.eigvalsh(both[1])
        # rigid-body motions leave rounding: 1e-14 of the largest eigenvalue
        assert np.all(lam[:, 0] > -1e-13 * lam[:, -1])


@pytest.mark.parametrize(("plate", "effect"), one_plate)
def test_a_problem_with_an_effect_can_be_sent_away_and_says_what_couples_stretching_with_bending(
    plate: str, effect: Effect
) -> None:
    problem, values = with_effect(plate, effect), values_at(effect, (1.0,))
    sent = pickle.loads(pickle.dumps(problem))
    for kind in MATRICES:
        np.testing.assert_array_equal(sent.coefficients(values, kind), problem.coefficients(values, kind))
        assert sent.forms(kind) == problem.forms(kind)
    couples = [
        {f.left.field in MEMBRANE, f.right.field in MEMBRANE} == {True, False}
        for f in problem.forms("stiffness")
    ]
    c = np.atleast_2d(problem.coefficients(values, "stiffness"))[0]
    largest = np.abs(c[couples]).max(initial=0.0) / np.abs(bare(plate).coefficients({}, "stiffness")).max()
    # the layups of these plates are symmetric: rounding of B, 1e-9 of the largest stiffness
    assert (largest > 1e-9) == effect.couples_stretching


# The derivatives


@pytest.mark.parametrize(("plate", "effect"), one_plate)
@pytest.mark.parametrize("sds", [0.0, 0.8])
def test_complex_step_of_the_coefficients_is_their_difference_quotient(
    plate: str, effect: Effect, sds: float
) -> None:
    problem = with_effect(plate, effect)
    others = {name: np.array([value]) for name, value in effect.scaled(sds).items()}
    for p, kind in product(effect.parameters, MATRICES):
        # at the null the springs of a clamp change within 1e-4 of their compliance's standard deviation
        h = scale_of(p) * (1e-3 if sds else 1e-6)
        x = sds * scale_of(p)
        if sds or p.prior.lower < 0.0:
            steps, weights, tolerance = (-2, -1, 1, 2), (1 / 12, -8 / 12, 8 / 12, -1 / 12), 1e-5
        else:  # one-sided quotients of third order, with steps a fiftieth of the least compliance at most
            steps, weights, tolerance = (0, 1, 2, 3), (-11 / 6, 3.0, -1.5, 1 / 3), 1e-4
        at = problem.coefficients({**others, p.name: x + h * np.array(steps)}, kind)
        if at.ndim == 1:  # the effect leaves this matrix alone
            continue
        stepped = problem.coefficients({**others, p.name: np.array([x + 1e-30j])}, kind)
        analytic = np.imag(stepped[0]) / 1e-30
        quotient = np.array(weights) @ at / h
        # rounding of the coefficient over the step
        noise = 1e-14 * np.abs(at).max() / h
        assert np.all(np.abs(analytic - quotient) <= tolerance * np.abs(analytic) + noise)


def of_a_stack(layup: Layup, before: StateFunction, values: Values) -> PlateState:
    """The state with its layup as a stack of one, whose stiffness is integrated ply by ply."""
    geometry = laminate_geometry(layup.angles_deg[None], symmetric=layup.is_symmetric, plies=layup.plies)
    return replace(before(values), layup=geometry)


@pytest.mark.parametrize(
    "plate", [name for name in builtin_names() if not builtin(name).plate.layup.n_unknown]
)
def test_coefficients_in_closed_form_are_those_of_the_general_laminate(plate: str) -> None:
    specimen, of_plate, rng = builtin(plate), facts(plate), np.random.default_rng(0)
    problem = plate_problem(specimen, constant_parameters(specimen))
    general = replace(problem, state=partial(of_a_stack, specimen.plate.layup, problem.state))
    for effect in (None, *(e for e in applicable(of_plate) if e.change is not None)):
        both = [p if effect is None else extend(p, placed(effect), of_plate) for p in (problem, general)]
        parameters = both[0].parameters
        x = parameters.sample(rng, 12)
        x = x[both[0].admissible(parameters.mapping(x))][:3]
        assert len(x)
        n, step = parameters.size, 1e-25 * np.abs(x)
        model = PlateModel(AffineOperator(both[0], None, ()), 1, np.zeros(1))
        stepped = parameters.mapping(x[:, None] + 1j * step[:, None] * np.eye(n))
        for kind, value, slope in zip(
            MATRICES, model.coefficients(x), model.coefficient_derivatives(x), strict=True
        ):
            full = both[1].coefficients(stepped, kind)
            full = np.broadcast_to(full, (len(x), n, full.shape[-1]))
            expected = np.swapaxes(full.imag / step[..., None], 1, 2)
            size = np.abs(value).max(axis=1)[:, None]
            assert np.all(np.abs(value - full.real[:, 0]) <= 1e-12 * size)
            # of the largest slope along a parameter, or of what rounding leaves of none
            largest = np.maximum(np.abs(expected).max(axis=1), 1e-3 * size / np.abs(x))
            assert np.all(np.abs(slope - expected) <= 1e-12 * largest[:, None])


# The discretisations


@pytest.mark.parametrize(
    ("plate", "effect"),
    [
        pytest.param(plate, e, id=f"{plate}-{e.name}", marks=[pytest.mark.slow] if e.name in LONG else [])
        for plate, e in PAIRS
        # shifts of other plates are those of the page
        if plate == first_plate(e) or e.name.startswith("clamp")
    ],
)
def test_ritz_and_finite_elements_agree(plate: str, effect: Effect) -> None:
    # elements must be smaller than the bell and than the loose corner, and end where a corner is missing
    counts = {"damage": (40, 40), "clamp_slip": (24, 40), "outline": (50, 50)}.get(effect.name, (16, 16))
    f, g = ritz(plate, effect), elements(plate, effect, counts=counts)
    np.testing.assert_allclose(f, g, rtol=1e-3)
    a, b = f[1] / f[0] - 1, g[1] / g[0] - 1
    # shifts agree within 2 %, or within 0.02 % of the frequency
    assert np.all(np.abs(a - b) < np.maximum(0.02 * np.abs(b), 2e-4))


# The frequencies


@pytest.mark.parametrize(("plate", "effect"), cases([e for e in ON_THE_PLATE if e.sign]))
def test_an_effect_with_a_sign_shifts_no_frequency_the_other_way(plate: str, effect: Effect) -> None:
    # rounding, mostly that of the stiff springs of a clamp
    assert np.all(effect.sign * shifts(plate, effect)[0] > -0.02)


@pytest.mark.parametrize(
    ("plate", "name", "shown"),
    [
        pytest.param(plate, name, shown, id=f"{plate}-{name}")
        for name, row in EXPECTED.items()
        for plate, shown in zip(MODES, row, strict=True)
        if shown != "-"
    ],
)
def test_the_largest_shift_is_the_known_one(plate: str, name: str, shown: str) -> None:
    """An independent prototype with other trial functions found these within 20 %."""
    up, _ = shifts(plate, BY_NAME[name])
    largest = up[np.argmax(np.abs(up))]
    decimals = len(shown.partition(".")[2])
    assert abs(float(shown) - largest) < 0.02 * abs(largest) + 0.6 * 10.0**-decimals


@pytest.mark.parametrize(
    "effect", [e for e in ON_THE_PLATE if e.applies_to(facts("C1"))], ids=lambda e: e.name
)
def test_the_slope_at_the_null_is_zero_on_a_free_orthotropic_plate_if_the_record_says_so(
    effect: Effect,
) -> None:
    f = ritz("C1", placed(of_plate("C1", effect)), (0.0, 0.5, 1.0), degree=9)
    small, large = (np.abs(row / f[0] - 1).max() for row in f[1:])
    if effect.even:
        # a quadratic shift: a quarter at half the size, but for the fourth power at 20 degrees
        assert small / large == pytest.approx(0.25, rel=0.15)
    else:
        # half the shift at half the size
        assert small / large > 0.4


# An effect of one's own, which no file of the package knows


@cache
def stiffener() -> Effect:
    """The example of the page, in other units and stiffer on thicker plates."""
    _, _, code = PAGE.partition('```python title="stiffener.py"\n')
    names: dict[str, Any] = {}
    exec(code.partition("```")[0], names)
    effect: Effect = names["STIFFENER"]
    (size,) = effect.parameters
    shown = replace(size, shown=("kN cm2", 10.0))
    look = "Look for a rib along the middle."
    return replace(effect, parameters=(shown,), check=look, size_factor=lambda facts: facts.thickness / 3e-3)


@pytest.mark.slow
def test_it_is_claimed_where_it_is_hidden_and_in_the_document_with_its_unit_and_on_the_screen() -> None:
    own, rng = stiffener(), np.random.default_rng(1)
    # by elements, with 0.1 % of noise
    f = elements("C1", own, (4.0,), counts=(24, 48), n_modes=10)[0] * (1.0 + 1e-3 * rng.standard_normal(10))
    listed = Measurement(np.sort(f).round(1), 0.1, 1e-3, None, ("",) * 10, complete=True)
    hidden = replace(builtin("C1"), measurement=listed)
    found = diagnose(hidden, catalogue=(*CATALOGUE, own), next_test="never")
    assert found.claim in ("named", "class")
    assert found.causes[0] == "stiffener"
    document = json.loads(json.dumps(found.to_dict()))
    (entry,) = (h for h in document["hypotheses"] if h["cause"] == "stiffener")
    size = entry["parameters"]["stiffener"]
    assert size["unit"] == "kN cm2"
    assert size["mean"] == pytest.approx(4.0 * 5.0, abs=3.0 * size["sd"])
    # C1 is 3.2 mm thick
    scale = document["priors"]["effects"]["stiffener"]["stiffener"]["scale"]
    assert scale == pytest.approx(5.0 * 3.2 / 3)
    assert "kN cm2" in found.summary(verbose=True)
    # checks stand beside each other where two causes are claimed
    both = replace(found.diagnosis, claim=Claim("class", ("stiffener", "warp"), 0.99))
    screen = replace(found, diagnosis=both).summary(verbose=True)
    (line,) = (line for line in screen.splitlines() if own.check in line)
    assert line.split() == f"{own.title} {own.check}".split()


def test_it_raises_frequencies_alike_on_both_discretisations() -> None:
    f, g = ritz("C1", stiffener(), degree=10), elements("C1", stiffener(), counts=(24, 48))
    a, b = f[1] / f[0] - 1, g[1] / g[0] - 1
    assert np.all(a > 0)
    assert a.max() > 1e-3
    # elements of half the bell's width
    np.testing.assert_allclose(a, b, atol=2e-4)


def test_the_page_holds_the_table_of_the_catalogue_with_a_reason_for_every_cause() -> None:
    """``python -m cpam_bayes.effects.table docs/effects.md`` writes it."""
    assert f"{BEGIN}\n{catalogue_table()}\n{END}" in PAGE
    _, _, *rows = catalogue_table().splitlines()
    assert len(rows) == len(CATALOGUE)
    assert not [row for row in rows if row.split("|")[-2].strip()[:1] in ("", "-")]


# Names, which nothing outside the effects knows

PACKAGE = Path(cpam_bayes.__file__).parent
NAMES = {e.name for e in CATALOGUE} | {p.name for e in CATALOGUE for p in e.parameters}
# Words of the plate file, which name its numbers and tables where no effect is meant.
PLATE_WORDS = {*SIZES, "air", "air_density", "frequency_scale", "layup", "material", "outline"}
# Truths that are made without the catalogue, and their scores, name what they hide: they may not ask it.
VALIDATION = PACKAGE.parent / "studies" / "validation"
TRUTHS = [path for folder in ("independent", "claims") for path in sorted((VALIDATION / folder).glob("*.py"))]
MODULES = [p for p in sorted(PACKAGE.rglob("*.py")) if "effects" not in p.relative_to(PACKAGE).parts]


def known(source: str, names: set[str]) -> set[object]:
    return names & {node.value for node in ast.walk(ast.parse(source)) if isinstance(node, ast.Constant)}


@pytest.mark.parametrize("path", MODULES, ids=lambda p: str(p.relative_to(PACKAGE)))
def test_a_module_outside_the_effects_names_none(path: Path) -> None:
    # where causes are compared and shown no such name can be anything else
    of_diagnosis = NAMES | {e.family for e in CATALOGUE}
    names = of_diagnosis if "diagnos" in str(path.relative_to(PACKAGE)) else NAMES - PLATE_WORDS
    assert known(path.read_text(encoding="utf-8"), names) == set()


def test_truths_are_made_without_the_catalogue() -> None:
    assert len(TRUTHS) > 10
    for path in TRUTHS:
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            named = [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            named += [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            assert not any(n.startswith(("cpam_bayes.effects", "cpam_bayes.mechanics")) for n in named), path
            if path.parent.name == "independent":
                assert not any(n.startswith("cpam_bayes") for n in named), path
                assert all(n.startswith("validation.independent") for n in named if "validation" in n), path


def test_a_name_is_seen_in_comparisons_tuples_and_keys() -> None:
    source = 'x == "warp"\ny in ("skew", 1)\nz = {"damage": 2}\nmatch z:\n    case "outlier":\n        pass\n'
    assert known(source, NAMES) == {"warp", "skew", "damage", "outlier"}
