"""Signatures: what the constants imitate, what is left, and which causes look alike."""

from typing import Any

import numpy as np
import pytest

from cpam_bayes.diagnosis.evidence import weighing
from cpam_bayes.diagnosis.evidence.marginal import Marginal
from cpam_bayes.diagnosis.evidence.weighing import marginal_of
from cpam_bayes.diagnosis.hypotheses import NONE, Hypothesis
from cpam_bayes.diagnosis.signatures import (
    Menu,
    Projector,
    Signature,
    alike,
    compared_by_fits,
    cosine,
    nearest_of,
    projector_of,
    signature_of,
    with_equal_fits,
)
from cpam_bayes.effects import Effect, ListChange
from cpam_bayes.effects.effect import MISREADING
from tests.diagnosis.toy_plates import (
    BUMP,
    DENT,
    F0,
    SD,
    A,
    Array,
    a_list,
    case,
    cause,
    even,
    hypothesis,
    misread,
    straight,
    whole_normal,
)

NOISE = 0.001
PRIOR = whole_normal(0.02)
SHIFTS = {
    "bump": BUMP,
    "more bump": -2.0 * BUMP,
    "bump and stiffer": BUMP + A @ [0.5, -1.0],
    "dent": DENT,
    "stiffer": A @ [0.6, 0.3],
}
EFFECTS = {name: cause(name, PRIOR) for name in SHIFTS}


def plate(f: Array, noise: float = NOISE, *, n_modes: int = 8) -> tuple[Marginal, Projector, object]:
    effects = [(e, straight(SHIFTS[name])) for name, e in EFFECTS.items()]
    own = case(a_list(f, noise), effects, n_modes=n_modes)
    none = marginal_of([own], Hypothesis(NONE, NONE), (0,))
    return none, projector_of(none), own


def signature(of: Effect | Hypothesis, f: Array, noise: float = NOISE) -> Signature:
    none, projector, own = plate(f, noise)
    asked = of if isinstance(of, Hypothesis) else hypothesis(of, 0.1)
    marginal = marginal_of([own], asked, (0,), none=none)  # type: ignore[list-item]
    return signature_of(weighing.Tested(asked, (0,), marginal), none, projector)


def weighted_slopes(f: Array, noise: float = NOISE) -> Array:
    """Derivatives over the scores of the constants in units of the noise."""
    return np.asarray(SD * A * F0[:, None] / (noise * f)[:, None])


def test_the_projection_is_the_precision_with_the_constants_integrated_and_absorbs_their_mean() -> None:
    _, projector, _ = plate(F0)
    a = weighted_slopes(F0)
    marginal = np.linalg.inv(np.eye(8) + a @ a.T)  # of a linear model with Gaussian priors
    shift = np.random.default_rng(0).standard_normal(8)
    visible = projector.root @ shift
    assert visible @ visible == pytest.approx(shift @ marginal @ shift, rel=1e-9)
    shift = a @ [0.8, -0.3]
    expected = np.linalg.solve(a.T @ a + np.eye(2), a.T @ shift)
    np.testing.assert_allclose(projector.absorb @ shift, expected, rtol=1e-9)


def test_a_shift_that_the_constants_can_make_is_absorbed_and_another_is_visible() -> None:
    absorbed = signature(EFFECTS["stiffer"], F0 * (1.0 + A @ [0.02, 0.01]))
    assert absorbed.is_absorbed
    # a standard deviation of the constants is 25 to 50 of the noise
    assert absorbed.visible_fraction < 0.05
    size = absorbed.bias / SD  # scores per relative change of a constant
    assert size[0] / size[1] == pytest.approx(2.0, rel=0.02)
    found = signature(EFFECTS["dent"], F0 * (1.0 + 0.01 * DENT))
    assert not found.is_absorbed
    a = weighted_slopes(F0)
    direction = DENT * F0 / (NOISE * F0)
    left = direction - a @ np.linalg.lstsq(a, direction, rcond=None)[0]
    # the constants' priors are wide against the noise: nearly a plain projection
    assert found.visible_fraction == pytest.approx(np.linalg.norm(left) / np.linalg.norm(direction), abs=0.01)
    assert cosine(absorbed, found) == 0.0


def test_the_shift_has_the_size_and_sign_that_the_data_suggest() -> None:
    for size in (0.012, -0.012):
        found = signature(EFFECTS["dent"], F0 * (1.0 + size * DENT))
        np.testing.assert_allclose(found.shift, size * DENT / NOISE, atol=0.1 * abs(size) / NOISE)


def test_the_largest_shift_is_that_of_one_catalogue_standard_deviation() -> None:
    found = signature(EFFECTS["bump"], F0)
    # the catalogue's size of a parameter that is normal is its mean, zero here: nothing is shifted
    assert found.largest == pytest.approx(0.0, abs=1e-12)
    assert signature(misread(3), F0).largest == pytest.approx(MISREADING.prior.scale, rel=0.01)  # type: ignore[attr-defined]


def test_the_size_of_an_even_cause_is_no_mean_of_both_its_peaks() -> None:
    warp = cause("warp", whole_normal(0.1), is_even=True)
    f = F0 * (1.0 + 0.2**2 * DENT)
    own = case(a_list(f, NOISE), [(warp, even(DENT))])
    none = marginal_of([own], Hypothesis(NONE, NONE), (0,))
    asked = hypothesis(warp, 0.1)
    found = signature_of(
        weighing.Tested(asked, (0,), marginal_of([own], asked, (0,), none=none)), none, projector_of(none)
    )
    np.testing.assert_allclose(found.shift * NOISE, 0.2**2 * DENT, atol=0.1 * 0.2**2)


def signatures(f: Array) -> dict[str, Signature]:
    return {name: signature(effect, f) for name, effect in EFFECTS.items()}


def test_causes_whose_visible_shifts_are_parallel_are_alike() -> None:
    found = signatures(F0 * (1.0 + 0.01 * BUMP))
    names = list(found)
    by_name = {n: {names[j] for j in alike(list(found.values()), i)} for i, n in enumerate(names)}
    same = {"bump", "more bump", "bump and stiffer"}
    for name in same:
        assert by_name[name] == same - {name}
    assert by_name["dent"] == set()
    assert by_name["stiffer"] == set()
    assert abs(cosine(found["bump"], found["more bump"])) == pytest.approx(1.0, abs=1e-9)
    # what is added lies in the constants' span
    assert abs(cosine(found["bump"], found["bump and stiffer"])) > 0.99


def test_the_cosine_is_that_of_what_the_constants_leave() -> None:
    found = signatures(F0 * (1.0 + 0.01 * (BUMP + DENT)))
    left = [d - A @ np.linalg.lstsq(A, d, rcond=None)[0] for d in (BUMP, DENT)]
    expected = left[0] @ left[1] / np.linalg.norm(left[0]) / np.linalg.norm(left[1])
    sign = np.sign(found["bump"].shift @ BUMP) * np.sign(found["dent"].shift @ DENT)
    assert cosine(found["bump"], found["dent"]) == pytest.approx(sign * expected, abs=0.02)


def test_the_nearest_shift_is_one_that_is_there() -> None:
    target = np.array([1.0, 0.0])
    # of a cause that can do the opposite only, the nearest is next to nothing and has no direction
    size = np.linspace(0.0, 1.0, 21)[:, None]
    opposite = -size * target + 1e-6
    assert nearest_of(opposite, target) == 3  # 0.15: the one before is a trifle too small
    assert Menu(opposite, np.ones(21)).cosine(target) == pytest.approx(1.0, abs=1e-6)
    assert nearest_of(size * [1.0, 0.5], target) == 16  # at 0.8
    assert nearest_of(1e-3 * size * target, target) == 20


def test_a_missed_mode_shifts_all_that_follow() -> None:
    found = signature(
        Hypothesis("mode_identity", "list", listed=ListChange(missed=(5,))),
        np.delete(F0 * (1.0 + A @ [0.01, 0.02]), 5),
    )
    assert found.shift.shape == (7,)
    # the plain model is bent by the wrong pairing: by the noise's measure both ends are far off
    assert np.abs(found.shift[5:]).min() > 10.0 * NOISE
    assert found.visible_fraction > 0.3


@pytest.mark.parametrize(("at", "peak"), [(4, 350.0), (3, F0[3]), (4, F0[3])])
def test_a_false_peak_has_a_signature_and_may_equal_its_neighbour(at: int, peak: float) -> None:
    """Two frequencies of a list that are rounded to the same number are two frequencies."""
    false = Hypothesis("mode_identity", "list", listed=ListChange(spurious=at))
    found = signature(false, np.insert(F0[:7], 4, peak))
    assert found.shift.shape == (8,)
    assert np.all(np.isfinite(found.shift))


@pytest.mark.parametrize(
    ("likeness", "seen", "same"),
    [(0.951, 1.0, True), (0.949, 1.0, False), (1.0, 0.101, True), (1.0, 0.099, False)],
)
def test_signatures_are_equal_from_a_cosine_of_0_95_where_a_tenth_of_both_is_visible(
    likeness: float, seen: float, same: bool
) -> None:
    shifts = np.array([[1.0, 0.0], [likeness, np.sqrt(1.0 - likeness**2)]])
    one, other = (Signature(shift, shift, seen, np.zeros(2), 0.0) for shift in shifts)
    assert alike([one, other], 0) == ((1,) if same else ())


def test_causes_with_one_signature_are_told_apart_by_fits() -> None:
    by_signature = {"turned": ("skew", "inner"), "skew": ("turned",), "mass": (), "load": ()}
    peak = {"turned": 30.0, "skew": 22.9, "inner": 23.1, "mass": 28.1, "load": 27.9}
    probability = {"turned": 0.98, "skew": 1e-4, "inner": 5e-3, "mass": 4e-3, "load": 4e-3}
    found = with_equal_fits(by_signature, peak, probability)
    # e^7.1 behind at any size: skew is another cause; inner plies fit worse by e^6.9, which decides nothing.
    # Within e^2 fits are equal
    assert found["turned"] == ("inner", "mass")
    # what fits better imitates the worse one
    assert set(found["skew"]) == {"turned", "inner", "mass", "load"}
    # where the priors give it a hundredth of the probability after all, it stays in the class
    for p, stays in ((0.0097, False), (0.0099, True)):
        shared = with_equal_fits(by_signature, peak, {**probability, "skew": p})
        assert ("skew" in shared["turned"]) is stays
    # without fits only signatures are compared
    assert with_equal_fits(by_signature, {}, probability)["turned"] == ("skew", "inner")


def test_fits_are_compared_of_what_is_probable_and_of_what_looks_like_the_leading_cause() -> None:
    probability = {"turned": 0.8, "mass": 0.0041, "load": 0.0039, "skew": 1e-6, NONE: 0.1}
    unused: Any = None
    tested = {c: weighing.Tested(Hypothesis(c, c), (0,), unused) for c in probability if c != NONE}
    assert set(compared_by_fits(tested, probability, {"turned": ("skew",)})) == {"turned", "mass", "skew"}
