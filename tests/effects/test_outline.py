"""A missing corner: a shortened beam, independent elements, the corners that look alike, and its mass."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from cpam_bayes.effects import extend, variants
from cpam_bayes.effects.geometry import OUTLINE, _cut
from cpam_bayes.plate.layup import parse_layup
from tests.effects.cases import bare, facts
from tests.effects.test_physics import facts_of, frequencies
from tests.plates import plate
from validation.independent.true_plate import Patch, TruePlate, natural_frequencies

ALUMINIUM = {"E1": 70e9, "nu12": 0.33}
N_MODES = 8
# A square as wide as a strip of 300 x 20 mm.
CUT_OFF = {"missing_area": 0.99 * 0.02 / 0.3}


def test_a_strip_without_its_end_is_a_shorter_beam() -> None:
    problem = plate(0.3, 0.02, 1e-3, 2700.0, {"E1": 70e9, "nu12": 0.0}, edges="CFFF")
    whole = replace(OUTLINE, change=partial(_cut, (1.0, 1.0, 1.0)))
    shorter = extend(problem, whole, facts_of(problem))
    f, full = (frequencies(p, v, n=1, degree=12) for p, v in ((shorter, CUT_OFF), (problem, {})))
    # a hundredth of the end is left: it weighs 0.07 % of the strip, of which a tip mass counts four times
    assert f[0] / full[0] == pytest.approx((0.3 / 0.28) ** 2, rel=5e-3)


@pytest.mark.parametrize("extent", [0.1, 0.16, 0.25])
def test_a_square_cut_off_shifts_as_in_independent_elements(extent: float) -> None:
    true = TruePlate(0.26, 0.2, 2e-3, 2700.0, "FFFF", (0.0,), ALUMINIUM, 5 / 6, mesh=40)
    side = extent * true.width
    gone = Patch("rectangle", true.length, true.width, side, side, 1.0, gone=True)
    cut, whole = (natural_frequencies(replace(true, patches=p), N_MODES) for p in ((gone,), ()))
    expected = cut / whole - 1
    problem = plate(true.length, true.width, true.thickness, true.density, ALUMINIUM)
    of = facts_of(problem)
    (form,) = (form for form in variants(OUTLINE, of) if form.place == (1.0, 1.0, extent))
    missing = form.parameters[0].prior.upper
    assert missing == pytest.approx(0.99 * side**2 / (true.length * true.width))
    found, none = (
        frequencies(p, v, n=N_MODES, degree=13)
        for p, v in ((extend(problem, form, of), {"missing_area": missing}), (problem, {}))
    )
    left = found / none - 1 - expected
    # products of polynomials do not bend away from what is gone: a part of what the form error counts
    assert np.sqrt(np.mean(left**2)) < 0.2 * np.sqrt(np.mean(expected**2))
    assert expected.max() > 0.01


@pytest.mark.parametrize(
    ("edges", "layup", "loaded", "expected"),
    [
        ("FFFF", None, False, [(1, 1)]),
        ("FFFF", "[30/-30]_s", False, [(1, 1), (1, 0)]),  # half a turn maps opposite corners
        ("FFFF", None, True, [(1, 1), (1, 0), (0, 1), (0, 0)]),
        ("CFFF", None, False, [(1, 1)]),
        ("CFFF", "[30/-30]_s", False, [(1, 1), (1, 0)]),
        ("FFCF", None, False, [(0, 1)]),
        ("FFSC", None, False, [(0, 0)]),
        ("FSFS", None, False, []),
    ],
)
def test_free_corners_that_look_alike_miss_once(
    edges: str, layup: str | None, loaded: bool, expected: list[tuple[int, int]]
) -> None:
    of = replace(facts("C1"), edges=edges, loaded=loaded)
    of = replace(of, layup=parse_layup(layup)) if layup else of
    found = [form.place for form in variants(OUTLINE, of)]
    assert found == [(*corner, extent) for corner in expected for extent in (0.06, 0.1, 0.16, 0.25)]


@pytest.mark.parametrize("weighed", [False, True])
def test_a_weighed_plate_keeps_its_mass_without_a_corner(weighed: bool) -> None:
    of = replace(facts("C1"), weighed=weighed)
    (form,) = (form for form in variants(OUTLINE, of) if form.place == (1.0, 1.0, 0.16))
    problem = extend(bare("C1"), form, of)
    missing = 0.5 * form.parameters[0].prior.upper
    share = 0.16**2 * min(of.length, of.width) / max(of.length, of.width)
    w, of_square = (problem.coefficients({"missing_area": np.array([missing])}, "mass")[0][i] for i in (2, 7))
    assert w + share * of_square == pytest.approx((1.0 if weighed else 1.0 - missing) * of.mass, rel=1e-12)
