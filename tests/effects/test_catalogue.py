"""The contract of an effect, over the whole catalogue and both discretisations."""

import ast
import json
import pickle
from dataclasses import replace
from functools import cache, lru_cache, partial
from itertools import combinations, product
from operator import attrgetter
from pathlib import Path

import numpy as np
import pytest

import cpam_bayes
from cpam_bayes.diagnosis.hypotheses import Claim
from cpam_bayes.effects import CATALOGUE, applicable, extend, scale_of, variants
from cpam_bayes.effects.table import BEGIN, END, catalogue_table
from cpam_bayes.forward_model.model import SIZES, PlateModel, constant_parameters, plate_problem
from cpam_bayes.mechanics.affine import AffineOperator
from cpam_bayes.mechanics.dense import MATRICES
from cpam_bayes.parameters import Mixture, ScaledStudentT
from cpam_bayes.plate import Measurement
from cpam_bayes.plate.edges import conditions
from cpam_bayes.plate.laminate import laminate_geometry
from cpam_bayes.plate.layup import parse_layup
from cpam_bayes.plate.reader import builtin, builtin_names
from cpam_bayes.questions.diagnose import diagnose
from tests.effects import cases
from tests.effects.cases import BY_NAME, MODES, SUPPORTED, elements, facts, form, ritz, values_at, with_effect

PAGE = (Path(__file__).parents[2] / "docs" / "effects.md").read_text(encoding="utf-8")
# Largest shift of a frequency at 1 sd, %, of the first 6, 6 and 10 modes of C1, A2 and D3. A mass is at
# (0.95, 0.95), a strip along x = length, smooth damage of extent 0.05 at the centre.
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
# Names in the contract: answers, stores and studies contain them.
BESIDE = {"soft_clamp", "soft_support", "mode_identity", "outlier", "material", "layup", "swapped_sides"}
KEPT_NAMES = BESIDE | set(EXPECTED)
ON_THE_PLATE = [e for e in CATALOGUE if e.change or e.observe]
OF_THE_PROBLEM = [e for e in CATALOGUE if e.change is not None]
MEMBRANE = ("u", "v")
CLAMPS = {"clamp_rotation", "clamp_translation", "soft_clamp", "clamp_slip", "clamp_length"}
LONG = ("air", "damage", "clamp_slip", "warp", "taper_x", "taper_y", "outline")  # many forms or big matrices


def of_plates(effects):
    return [pytest.param(p, e, id=f"{p}-{e.name}") for e in effects for p in plates_with(e)]


def plates_with(effect):
    """Those of the page's plates that can have the effect, or the supported one if none can."""
    return [plate for plate in MODES if effect.applies_to(facts(plate))] or [SUPPORTED]


def first_plate(effect):
    """A plate that can have the effect: the free one if possible, else the thick cantilever."""
    first, *_, last = plates_with(effect) * 2
    return first if first == "C1" else last


one_plate = [pytest.param(first_plate(e), form(first_plate(e), e), id=e.name) for e in OF_THE_PROBLEM]
by_name = attrgetter("name")
every_effect = pytest.mark.parametrize("effect", CATALOGUE, ids=by_name)


@lru_cache
def shifts(plate, effect):
    none, one = ritz(plate, form(plate, effect))
    return 100 * (one / none - 1)


def test_names_of_causes_and_of_parameters_are_unique_and_those_of_the_contract_stay():
    names = [effect.name for effect in CATALOGUE]
    assert set(names) >= KEPT_NAMES
    for each in (names, [p.name for effect in CATALOGUE for p in effect.parameters]):
        assert len(set(each)) == len(each)


@every_effect
def test_the_null_is_possible_and_sizes_are_shown_in_units_with_priors_of_student_t(effect):
    for p in effect.coordinates:
        assert p.prior.lower < scale_of(p) == p.null < p.prior.upper, p.name
    for p in effect.sizes:
        assert p.null == 0.0
        assert p.prior.lower <= 0.0 < scale_of(p) < p.prior.upper, p.name
        unit, factor = p.display
        assert factor == 1.0 or unit != p.unit  # a value shown in SI has its unit, or is a number
        assert 1e-3 <= factor * scale_of(p) <= 1e6, p.name
        if isinstance(p.prior, Mixture):
            assert p.prior.fraction == 0.1
            assert p.prior.wide.sd >= 1.3 * p.prior.narrow.sd
            assert max(p.prior.upper, -p.prior.lower) > 4.0 * scale_of(p)
        if effect.name in ("air", "outline"):  # known; the same over any part of its square
            continue
        tolerance = p.prior.parts[0][1]
        assert (type(tolerance), tolerance.degrees_of_freedom) == (ScaledStudentT, 4.0)
        if effect.name not in ("transverse_shear", "shear_ratio"):  # within a factor of two
            # the truncation removes less than 4 % of the tails, which must reach far
            whole = ScaledStudentT(tolerance.scale, 4.0, min(p.prior.lower, 0.0) * 1e6, 1e6 * p.prior.upper)
            assert tolerance.log_density(0.0) - whole.log_density(0.0) < 0.04, p.name


@every_effect
def test_an_effect_says_what_it_acts_on_and_how_it_enters(effect):
    acts = (effect.change, effect.observe, effect.pairings, effect.drops_references or None, effect.on_plate)
    assert sum(act is not None for act in acts) == 1
    assert effect.parameters or effect.change is effect.observe is None
    assert effect.name.isidentifier()
    assert "" not in (effect.title, effect.note)
    assert effect.check.endswith(".")
    for complete in (True, False):
        found = effect.pairings(7, complete) if effect.pairings else ()
        assert sum(v.fraction for v in found) == (pytest.approx(1.0) if found else 0)
        assert len({v.text for v in found}) == len(found)


def test_what_the_catalogue_says_of_causes_is_listed():
    # facts that nobody mistypes have no gross error, and purely gross errors are no mixture
    physics = {"transverse_shear", "shear_ratio", "membrane_stress", "viscoelastic", "resin_skin", "air"}
    misstated = {"thickness", "density", "length", "width", "frequency_scale", "outlier"}
    local = {"sensor_mass", "edge_mass", "damage", "clamp_slip", "support", "outline"}
    without = {e.name for e in CATALOGUE for p in e.sizes if not isinstance(p.prior, Mixture)}
    assert without == physics | misstated | local
    # sister plates share errors of the material and of the laboratory
    common = {"air", "frequency_scale", "shear_ratio", "transverse_shear", "viscoelastic"}
    assert {e.name for e in ON_THE_PLATE if e.is_common_to_sisters} == common
    of_list = {"mode_identity", "outlier", "soft_support"}
    assert {e.name for e in CATALOGUE if e.belongs_to == "test"} == CLAMPS | of_list
    ways = ("clamp_rotation", "clamp_translation", "soft_clamp", "clamp_slip")  # no others are exclusive
    apart = {frozenset((a.name, b.name)) for a, b in combinations(CATALOGUE, 2) if not a.goes_with(b)}
    assert apart == {frozenset(p) for p in combinations(ways, 2)}
    assert all(a.goes_with(b) == b.goes_with(a) for a, b in combinations(CATALOGUE, 2))


def test_the_expected_size_may_depend_on_the_plate():
    def forms(name, **of):
        return variants(BY_NAME[name], replace(facts("C1"), **of))

    h, (found,), (skin,) = facts("C1").thickness, forms("warp"), forms("resin_skin")
    (prior,) = (p.prior for p in found.sizes)
    assert (prior.lower, prior.upper) == pytest.approx((-4.0 * h, 4.0 * h))
    assert found.scaled(1.0)["sag"] == pytest.approx(0.25 * h)
    assert skin.parameters[0].prior.upper == pytest.approx(h / 5.0)
    for support in forms("support", first_frequency=120.0):
        assert support.scaled(1.0)["support_frequency"] == pytest.approx(12.0)
        assert support.parameters[0].prior.upper == pytest.approx(60.0)
    for measured, expected in ((None, 0.01), (0.004, 0.004), (0.03, 0.01), (0.0, 1e-4)):  # the total loss
        (loss,) = forms("viscoelastic", loss_factor=measured)
        assert loss.scaled(1.0)["loss_tangent"] == pytest.approx(expected)
        assert loss.parameters[0].prior.upper == pytest.approx(5.0 * expected)
    smooth, sharp = variants(replace(BY_NAME["damage"], size_factor=lambda facts: 0.5), facts("C1"))
    assert (smooth.scaled(1.0)["damage"], smooth.local, sharp.local) == (0.1, "bell", "rectangle")
    assert smooth.coordinates == sharp.coordinates


def test_effects_that_a_plate_cannot_have_or_have_no_place_yet_are_refused():
    lacks = {of: {e.name for e in CATALOGUE} - {e.name for e in applicable(facts(of))} for of in ("C1", "A2")}
    assert lacks["C1"] == CLAMPS | {"material", "soft_support", "swapped_sides"}
    of_plies = {"misorientation", "outer_ply_angle", "inner_ply_angle", "shear_ratio", "resin_skin", "layup"}
    assert lacks["A2"] == of_plies | {"support", "material", "soft_support"}
    for name, said in (
        ("clamp_slip", "clamp_slip: not possible on a plate with edges FFFF"),
        ("mode_identity", "mode_identity acts on the pairing"),
        ("sensor_mass", "fix its place with effect.at"),
        ("layup", r"layup: take one of its forms, variants\(effect, facts\)"),
    ):
        with pytest.raises(ValueError, match=said):
            extend(cases.bare("C1"), BY_NAME[name], facts("C1"))
    assert variants(BY_NAME["skew"], facts("C1")) == (BY_NAME["skew"],)


def test_what_leaves_a_plate_alike_is_no_effect_on_it():
    oblong = replace(facts("C1"), length=0.3)
    metal = replace(oblong, isotropic=True)
    one_way, unknown = (replace(oblong, layup=parse_layup(text)) for text in ("[30_8]", "[?/?]_s"))
    for name, of, applies in (
        ("swapped_sides", oblong, True),
        ("swapped_sides", metal, False),
        ("swapped_sides", replace(metal, edges="CFFF"), True),
        ("layup", oblong, True),
        *(("layup", of, False) for of in (metal, one_way, unknown)),
        *(("soft_support", replace(oblong, edges=e), "S" in e) for e in ("FFFF", "CFFF", "CFSF", "SSSS")),
    ):
        assert BY_NAME[name].applies_to(of) is applies, (name, of)


@pytest.mark.parametrize(("plate", "effect"), of_plates(ON_THE_PLATE))
def test_null_gives_back_the_bare_plate(plate, effect):
    effect = form(plate, effect)
    sprung = effect.change is not None and any(e.sprung for e in conditions(with_effect(plate, effect).edges))
    degree = 7 if sprung else 9
    found = ritz(plate, effect, (0.0, 1.0), degree=degree)[0]
    expected = ritz(plate, None, degree=degree)[0]
    # joined blocks round otherwise, 1e-8 to 1e-6 of a low frequency; a rigid clamp is a stiff spring, 1e-4
    np.testing.assert_allclose(found, expected, rtol=1e-4 if sprung else 2e-6)


@pytest.mark.parametrize(("plate", "effect"), one_plate)
def test_forms_are_symmetric_mass_definite_and_stiffness_semidefinite_within_the_prior(plate, effect):
    parameters = variants(effect, facts(plate))[0].parameters
    values = {p.name: np.array([p.prior.lower, scale_of(p), p.prior.upper]) for p in parameters}
    operator = cases.ritz_operator(with_effect(plate, effect), values, 6)
    k, m = (np.broadcast_to(c, (3, np.shape(c)[-1])) for c in operator.coefficients(values))
    for block in (each.dense() for each in operator.blocks):
        for each in (*block.stiffness.stack, *block.mass.stack):
            np.testing.assert_allclose(each, each.T, rtol=0, atol=1e-12 * np.abs(each).max())
        mass, stiffness = block.mass.assemble(m), block.stiffness.assemble(k)
        scale = 1 / np.sqrt(np.diagonal(mass, axis1=1, axis2=2))
        of_mass, lam = (np.linalg.eigvalsh(x * scale[:, :, None] * scale[:, None]) for x in (mass, stiffness))
        assert of_mass.min() > 1e-6
        assert np.all(lam[:, 0] > -1e-13 * lam[:, -1])  # rigid-body motions round to 1e-14 of the largest


@pytest.mark.parametrize(("plate", "effect"), one_plate)
def test_a_problem_with_an_effect_can_be_sent_and_says_what_couples_stretching_with_bending(plate, effect):
    problem, values = with_effect(plate, effect), values_at(effect, (1.0,))
    sent = pickle.loads(pickle.dumps(problem))
    for kind in MATRICES:
        np.testing.assert_array_equal(sent.coefficients(values, kind), problem.coefficients(values, kind))
        assert sent.forms(kind) == problem.forms(kind)
    fields = [(f.left.field in MEMBRANE, f.right.field in MEMBRANE) for f in problem.forms("stiffness")]
    c = np.atleast_2d(problem.coefficients(values, "stiffness"))[0][[left != right for left, right in fields]]
    largest = np.abs(c).max(initial=0.0) / np.abs(cases.bare(plate).coefficients({}, "stiffness")).max()
    assert (largest > 1e-9) == effect.couples_stretching  # symmetric layups: B is rounding, 1e-9


@pytest.mark.parametrize(("plate", "effect"), one_plate)
@pytest.mark.parametrize("sds", [0.0, 0.8])
def test_complex_step_of_the_coefficients_is_their_difference_quotient(plate, effect, sds):
    problem = with_effect(plate, effect)
    others = {name: np.array([value]) for name, value in effect.scaled(sds).items()}
    for p, kind in product(effect.parameters, MATRICES):
        h, x = scale_of(p) * (1e-3 if sds else 1e-6), sds * scale_of(p)  # a clamp's springs vary within 1e-4
        if sds or p.prior.lower < 0.0:
            steps, weights, tolerance = (-2, -1, 1, 2), (1 / 12, -8 / 12, 8 / 12, -1 / 12), 1e-5
        else:  # one-sided quotients of third order, with steps of at most a fiftieth of the least compliance
            steps, weights, tolerance = (0, 1, 2, 3), (-11 / 6, 3.0, -1.5, 1 / 3), 1e-4
        at = problem.coefficients({**others, p.name: x + h * np.array(steps)}, kind)
        if at.ndim == 1:  # the effect does not change this matrix
            continue
        analytic = np.imag(problem.coefficients({**others, p.name: np.array([x + 1e-30j])}, kind)[0]) / 1e-30
        quotient = np.array(weights) @ at / h
        noise = 1e-14 * np.abs(at).max() / h  # rounding of the coefficient over the step
        assert np.all(np.abs(analytic - quotient) <= tolerance * np.abs(analytic) + noise)


def of_a_stack(layup, before, values):
    """The state with its layup as a stack of one, whose stiffness is integrated ply by ply."""
    geometry = laminate_geometry(layup.angles_deg[None], symmetric=layup.is_symmetric, plies=layup.plies)
    return replace(before(values), layup=geometry)


@pytest.mark.parametrize("plate", [n for n in builtin_names() if not builtin(n).plate.layup.n_unknown])
def test_coefficients_in_closed_form_are_those_of_the_general_laminate(plate):
    specimen, of_plate, rng = builtin(plate), facts(plate), np.random.default_rng(0)
    problem = plate_problem(specimen, constant_parameters(specimen))
    general = replace(problem, state=partial(of_a_stack, specimen.plate.layup, problem.state))
    for effect in (None, *(e for e in applicable(of_plate) if e.change is not None)):
        own, other = (extend(p, cases.placed(effect), of_plate) if effect else p for p in (problem, general))
        parameters = own.parameters
        x = parameters.sample(rng, 12)
        x = x[own.admissible(parameters.mapping(x))][:3]
        assert len(x)
        n, step = parameters.size, 1e-25 * np.abs(x)
        model = PlateModel(AffineOperator(own, None, ()), 1, np.zeros(1))
        stepped = parameters.mapping(x[:, None] + 1j * step[:, None] * np.eye(n))
        both = zip(MATRICES, model.coefficients(x), model.coefficient_derivatives(x), strict=True)
        for kind, value, slope in both:
            full = other.coefficients(stepped, kind)
            full = np.broadcast_to(full, (len(x), n, full.shape[-1]))
            expected = np.swapaxes(full.imag / step[..., None], 1, 2)
            size = np.abs(value).max(axis=1)[:, None]
            assert np.all(np.abs(value - full.real[:, 0]) <= 1e-12 * size)
            # relative to the largest slope along a parameter, or to the rounding of a zero one
            largest = np.maximum(np.abs(expected).max(axis=1), 1e-3 * size / np.abs(x))
            assert np.all(np.abs(slope - expected) <= 1e-12 * largest[:, None])


@pytest.mark.parametrize(
    ("plate", "effect"),
    [
        pytest.param(plate, e, id=f"{plate}-{e.name}", marks=[pytest.mark.slow] if e.name in LONG else [])
        for e in OF_THE_PROBLEM
        for plate in plates_with(e)
        if plate == first_plate(e) or e.name.startswith("clamp")  # the page has the others' shifts
    ],
)
def test_ritz_and_finite_elements_agree(plate, effect):
    effect = form(plate, effect)
    # elements must be smaller than the bell and the loose corner, and end at the edge of a missing corner
    counts = {"damage": (40, 40), "clamp_slip": (24, 40), "outline": (50, 50)}.get(effect.name, (16, 16))
    f, g = ritz(plate, effect), elements(plate, effect, counts=counts)
    np.testing.assert_allclose(f, g, rtol=1e-3)
    a, b = f[1] / f[0] - 1, g[1] / g[0] - 1
    assert np.all(np.abs(a - b) < np.maximum(0.02 * np.abs(b), 2e-4))  # 2 % of the shift, or 0.02 % of f


@pytest.mark.parametrize(("plate", "effect"), of_plates([e for e in ON_THE_PLATE if e.sign]))
def test_an_effect_with_a_sign_shifts_no_frequency_the_other_way(plate, effect):
    assert np.all(effect.sign * shifts(plate, effect) > -0.02)  # rounding, mostly of a clamp's stiff springs


@pytest.mark.parametrize(
    ("plate", "name", "shown"),
    [
        pytest.param(plate, name, shown, id=f"{plate}-{name}")
        for name, row in EXPECTED.items()
        for plate, shown in zip(MODES, row, strict=True)
        if shown != "-"
    ],
)
def test_the_largest_shift_is_the_known_one(plate, name, shown):
    """An independent prototype with other trial functions found these within 20 %."""
    up = shifts(plate, BY_NAME[name])
    largest = up[np.argmax(np.abs(up))]
    assert abs(float(shown) - largest) < 0.02 * abs(largest) + 0.6 * 10.0 ** -len(shown.partition(".")[2])


@pytest.mark.parametrize("effect", [e for e in ON_THE_PLATE if e.applies_to(facts("C1"))], ids=by_name)
def test_the_slope_at_the_null_is_zero_on_a_free_orthotropic_plate_if_the_record_says_so(effect):
    f = ritz("C1", form("C1", effect), (0.0, 0.5, 1.0), degree=9)
    small, large = (np.abs(row / f[0] - 1).max() for row in f[1:])
    if effect.even:
        assert small / large == pytest.approx(0.25, rel=0.15)  # quadratic, but a fourth power at 20 degrees
    else:
        assert small / large > 0.4  # half the shift at half the size


@cache
def stiffener():
    """The example of the page, in other units and stiffer on thicker plates."""
    names = {}
    exec(PAGE.partition('```python title="stiffener.py"\n')[2].partition("```")[0], names)
    effect = names["STIFFENER"]
    (size,) = effect.parameters
    look = "Look for a rib along the middle."
    other = {"parameters": (replace(size, shown=("kN cm2", 10.0)),), "check": look}
    return replace(effect, **other, size_factor=lambda facts: facts.thickness / 3e-3)


@pytest.mark.slow
def test_it_is_claimed_where_it_is_hidden_and_in_the_document_with_its_unit_and_on_the_screen():
    own, noise = stiffener(), 1e-3 * np.random.default_rng(1).standard_normal(10)
    f = elements("C1", own, (4.0,), counts=(24, 48), n_modes=10)[0] * (1.0 + noise)  # with 0.1 % of noise
    listed = Measurement(np.sort(f).round(1), 0.1, 1e-3, None, ("",) * 10, complete=True)
    hidden = replace(builtin("C1"), measurement=listed)
    found = diagnose(hidden, catalogue=(*CATALOGUE, own), next_test="never")
    assert found.claim in ("named", "class")
    assert found.causes[0] == "stiffener"
    document = json.loads(json.dumps(found.to_dict()))
    (size,) = (h["parameters"]["stiffener"] for h in document["hypotheses"] if h["cause"] == "stiffener")
    assert (size["unit"], size["mean"]) == ("kN cm2", pytest.approx(4.0 * 5.0, abs=3.0 * size["sd"]))
    assert document["priors"]["effects"]["stiffener"]["stiffener"]["scale"] == pytest.approx(5.0 * 3.2 / 3)
    assert "kN cm2" in found.summary(verbose=True)
    both = replace(found.diagnosis, claim=Claim("class", ("stiffener", "warp"), 0.99))  # both checks
    screen = replace(found, diagnosis=both).summary(verbose=True)
    (line,) = (line for line in screen.splitlines() if own.check in line)
    assert line.split() == f"{own.title} {own.check}".split()


def test_it_raises_frequencies_alike_on_both_discretisations():
    each = ritz("C1", stiffener(), degree=10), elements("C1", stiffener(), counts=(24, 48))
    a, b = (f[1] / f[0] - 1 for f in each)
    assert np.all(a > 0)
    assert a.max() > 1e-3
    np.testing.assert_allclose(a, b, atol=2e-4)  # elements half as wide as the bell


def test_the_page_holds_the_table_of_the_catalogue_with_a_reason_for_every_cause():
    """To rewrite it: ``python -m cpam_bayes.effects.table docs/effects.md``."""
    assert f"{BEGIN}\n{catalogue_table()}\n{END}" in PAGE
    _, _, *rows = catalogue_table().splitlines()
    assert len(rows) == len(CATALOGUE)
    assert not [row for row in rows if row.split("|")[-2].strip()[:1] in ("", "-")]


PACKAGE = Path(cpam_bayes.__file__).parent
NAMES = {e.name for e in CATALOGUE} | {p.name for e in CATALOGUE for p in e.parameters}
# Words of the plate file for numbers and tables, where no effect is meant.
PLATE_WORDS = {*SIZES, "air", "air_density", "frequency_scale", "layup", "material", "outline"}
# Truths independent of the catalogue, and their scores, name what they hide but must not use it.
VALIDATION = PACKAGE.parent / "studies" / "validation"
TRUTHS = [path for folder in ("independent", "claims") for path in sorted((VALIDATION / folder).glob("*.py"))]
MODULES = [p for p in sorted(PACKAGE.rglob("*.py")) if "effects" not in p.relative_to(PACKAGE).parts]


def known(source, names):
    return names & {node.value for node in ast.walk(ast.parse(source)) if isinstance(node, ast.Constant)}


@pytest.mark.parametrize("path", MODULES, ids=lambda p: str(p.relative_to(PACKAGE)))
def test_a_module_outside_the_effects_names_none(path):
    of_diagnosis = NAMES | {e.family for e in CATALOGUE}  # such a name can only mean an effect
    names = of_diagnosis if "diagnos" in str(path.relative_to(PACKAGE)) else NAMES - PLATE_WORDS
    assert known(path.read_text(encoding="utf-8"), names) == set()


def test_truths_are_made_without_the_catalogue():
    assert len(TRUTHS) > 10
    for path in TRUTHS:
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            named = [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            named += [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            assert not any(n.startswith(("cpam_bayes.effects", "cpam_bayes.mechanics")) for n in named), path
            if path.parent.name == "independent":
                assert not any(n.startswith("cpam_bayes") for n in named), path
                assert all(n.startswith("validation.independent") for n in named if "validation" in n), path


def test_a_name_is_seen_in_comparisons_tuples_and_keys():
    source = 'x == "warp"\ny in ("skew", 1)\nz = {"damage": 2}\nmatch z:\n    case "outlier":\n        pass\n'
    assert known(source, NAMES) == {"warp", "skew", "damage", "outlier"}
