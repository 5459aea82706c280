"""Non-ideal edges and supports: clamps that rotate, translate or slip, soft supports, foam and pads.

The fields of a held edge are freed and held by springs k = stiffness / ((c + c0) side). c0 stands for the
rigid clamp or support: with c = 0 no frequency differs from that of the held edge by more than 1e-4.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from cpam_bayes.effects.effect import PERCENT, Effect, PlateFacts, one_sided, stacked
from cpam_bayes.mechanics.affine import Bell, Product, Twins
from cpam_bayes.mechanics.problem import Array, Atom, Form, PlateState, Problem, Region, Term, Values
from cpam_bayes.plate.edges import ALL_FREE, EDGES, FIELDS, Field, conditions, yielding

# Compliances of the clamp that counts as rigid, in units of side / D (turning) and side^3 / D. Stiffer
# springs would cost digits: their eigenvalues stand 1e12 above the lowest.
_RIGID_TURN, _RIGID_SHIFT = 3e-5, 1e-7
# Starts of the pieces of an edge that have one compliance each, fractions of its length from its first end.
_PIECES = (0.0, 0.01, 0.02, 0.035, 0.05, 0.07, 0.10, 0.14, 0.19, 0.24, 0.30)
# Compliance of the loose part at a distance d side from where the grip begins, as a fraction of that of a
# strip of this length, which is d side / D for rotations, d^3 side^3 / D for w and d side / A for u and v.
_LOOSE: dict[Field, tuple[float, int]] = {
    "u": (0.02, 1),
    "v": (0.02, 1),
    "w": (0.01, 3),
    "phi_x": (0.1, 1),
    "phi_y": (0.1, 1),
}
# Fields that each kind of compliance holds by springs.
_SPRUNG: dict[str, tuple[Field, ...]] = {
    "clamp_rotation": ("phi_x", "phi_y"),
    "clamp_translation": ("u", "v", "w"),
    "clamp_slip": FIELDS,
    "soft_support": ("w",),
}


def _yielding(edges: str, held: Sequence[int], way: str) -> str:
    letters = list(edges)
    for i in held:
        letter = yielding(edges[i], _SPRUNG[way])
        if letter is None:
            raise ValueError(
                f"{way}: the edges are {edges} already; a clamp's slip does not go with another "
                "clamp effect, and each effect goes once"
            )
        letters[i] = letter
    return "".join(letters)


def _spring(state: PlateState, axis: int, field: Field, compliance: Array) -> Array:
    """Spring per length of a held edge across an axis (0: x, 1: y), times the edge's length.

    D / (c a) on rotations, D / (c a^3) on w, A / (c a) on u and v.
    """
    stiffness = state.stiffness()
    side, along = (state.length, state.width) if axis == 0 else (state.width, state.length)
    bending, membrane = stiffness[..., 3 + axis, 3 + axis], stiffness[..., axis, axis]
    if field in ("phi_x", "phi_y"):
        return np.asarray(bending * along / ((compliance + _RIGID_TURN) * side))
    if field == "w":
        return np.asarray(bending * along / ((compliance + _RIGID_SHIFT) * side**3))
    return np.asarray(membrane * along / ((compliance + _RIGID_SHIFT) * side))


def _clamped(facts: PlateFacts) -> list[int]:
    return [i for i, edge in enumerate(conditions(facts.edges)) if edge.is_clamp]


def _supported(facts: PlateFacts) -> list[int]:
    return [i for i, edge in enumerate(conditions(facts.edges)) if not edge.is_clamp and "w" in edge.held_x]


def _compliant(
    parameter: str,
    way: str,
    problem: Problem,
    facts: PlateFacts,
    *,
    held_by: Callable[[PlateFacts], list[int]] = _clamped,
    unit: float = 1.0,
) -> Problem:
    """Problem in which the held edges of one kind are compliant.

    unit : of the parameter, in the compliances of ``_spring``
    """
    held = held_by(facts)
    springs = [(i, field) for i in held for field in _SPRUNG[way]]
    forms = tuple(Form(Atom(f), Atom(f), Region("edge", EDGES[i])) for i, f in springs)
    coefficients = partial(_compliant_springs, parameter, unit, springs)
    relaxed = replace(problem, edges=_yielding(problem.edges, held, way))
    return relaxed.with_terms(Term(way, "stiffness", forms, coefficients))


def _compliant_springs(
    parameter: str, unit: float, springs: list[tuple[int, Field]], state: PlateState, values: Values
) -> Array:
    c = unit * np.asarray(values[parameter])
    return stacked(*(_spring(state, i % 2, field, c) for i, field in springs))


def _soft(problem: Problem, facts: PlateFacts) -> Problem:
    """Springs on the rotations and on the translations of the clamped edges."""
    turning = _compliant("soft_rotation_compliance", "clamp_rotation", problem, facts)
    return _compliant("soft_translation_compliance", "clamp_translation", turning, facts)


def _slip(problem: Problem, facts: PlateFacts) -> Problem:
    """The grip fades from a fraction of the edge towards its first end.

    The compliance grows as that of a strip with the distance from where the grip begins, averaged over
    pieces of the edge. Springs that end abruptly would leave a singularity that no global basis resolves.
    """
    clamped = _clamped(facts)
    starts, ends = np.array(_PIECES), np.array([*_PIECES[1:], 1.0])
    springs = [(i, field) for i in clamped for field in FIELDS]
    forms = tuple(
        Form(Atom(field), Atom(field), Region("edge", EDGES[i], span=(float(start), float(end))))
        for i, field in springs
        for start, end in zip(starts, ends, strict=True)
    )

    coefficients = partial(_fading_springs, springs, starts, ends)
    relaxed = replace(problem, edges=_yielding(problem.edges, clamped, "clamp_slip"))
    return relaxed.with_terms(Term("clamp_slip", "stiffness", forms, coefficients))


def _fading_springs(
    springs: list[tuple[int, Field]], starts: Array, ends: Array, state: PlateState, values: Values
) -> Array:
    slipped = np.asarray(values["slip_fraction"])

    def mean_power(k: int) -> Array:
        """Mean of d^k over every piece, d = 0 where the grip holds, (..., n_pieces)."""
        parts = [slipped[..., None] - end for end in (starts, ends)]
        above, below = (np.where(np.real(d) > 0.0, d, 0.0) ** (k + 1) for d in parts)
        return np.asarray((above - below) / ((k + 1) * (ends - starts)))

    distance = {k: mean_power(k) for k in (1, 3)}
    stiffnesses = []
    for i, field in springs:
        fraction, k = _LOOSE[field]
        stiffnesses += [
            _spring(state, i % 2, field, fraction * distance[k][..., j]) for j in range(len(starts))
        ]
    return stacked(*stiffnesses)


def _has_clamp(facts: PlateFacts) -> bool:
    return bool(_clamped(facts))


# The springs of one clamp replace its held fields: two of these effects cannot do so together.
_WAYS = ("clamp_rotation", "clamp_translation", "soft_clamp", "clamp_slip")

CLAMP_ROTATION = Effect(
    name="clamp_rotation",
    title="clamp flexible in rotation",
    family="clamp",
    belongs_to="test",
    parameters=(one_sided("rotation_compliance", "", 0.02, 2.0, gross=0.2),),
    note="edge springs D11 / (c a) on both rotations",
    check="Tighten the clamp and measure again; rising frequencies confirm it.",
    change=partial(_compliant, "rotation_compliance", "clamp_rotation"),
    applies_to=_has_clamp,
    sign=-1,
    excludes=_WAYS,
    edges=_clamped,
    form_error=0.11,
)
CLAMP_TRANSLATION = Effect(
    name="clamp_translation",
    title="clamp flexible in translation",
    family="clamp",
    belongs_to="test",
    parameters=(one_sided("translation_compliance", "", 0.002, 0.2, gross=0.02),),
    note="edge springs D11 / (c a^3) on w, A11 / (c a) on u and v",
    check="Measure the motion of the clamp itself with a second accelerometer.",
    change=partial(_compliant, "translation_compliance", "clamp_translation"),
    applies_to=_has_clamp,
    sign=-1,
    excludes=_WAYS,
    edges=_clamped,
    form_error=0.05,
)
SOFT_CLAMP = Effect(
    name="soft_clamp",
    title="clamp flexible in rotation and translation",
    family="clamp",
    belongs_to="test",
    parameters=(
        one_sided("soft_rotation_compliance", "", 0.02, 2.0, gross=0.2),
        one_sided("soft_translation_compliance", "", 0.002, 0.2, gross=0.02),
    ),
    note="both springs at once: D11 / (c a) on the rotations, D11 / (c' a^3) on w, A11 / (c' a) on u and v",
    check="Clamp the plate between stiffer jaws that reach over the whole edge, and measure again.",
    change=_soft,
    applies_to=_has_clamp,
    sign=-1,
    excludes=_WAYS,
    edges=_clamped,
    form_error=0.07,
)
CLAMP_SLIP = Effect(
    name="clamp_slip",
    title="clamp grips part of the edge",
    family="clamp",
    belongs_to="test",
    parameters=(one_sided("slip_fraction", "", 0.05, _PIECES[-1], shown=PERCENT),),
    note="the grip fades over this fraction of the edge, from its first end",
    check="Check the contact along the clamped edge with a feeler gauge or pressure-sensitive film.",
    change=_slip,
    applies_to=_has_clamp,
    sign=-1,
    excludes=_WAYS,
    edges=_clamped,
    form_error=0.62,
)


def _has_support(facts: PlateFacts) -> bool:
    return bool(_supported(facts))


SOFT_SUPPORT = Effect(
    name="soft_support",
    title="simple support that gives",
    family="surroundings",
    belongs_to="test",
    # rubber, 10 mm wide and 3 mm high, under 0.4 m of aluminium, 3 mm thick, has 0.01; at 1 it is no support
    parameters=(one_sided("support_compliance", "", 0.01, 1.0, gross=0.1),),
    note=(
        "edge springs pi^4 D11 / (2 c a^3) on w of simply supported edges; on two of them a rigid strip "
        "bounces at c^-1/2 of its first frequency in bending"
    ),
    check="Measure the motion of the supported edges with a second accelerometer.",
    change=partial(_compliant, "support_compliance", "soft_support", held_by=_supported, unit=2.0 / np.pi**4),
    applies_to=_has_support,
    sign=-1,
    edges=_supported,
)


# First frequency of the plate for which the catalogue's size is given, Hz.
_TYPICAL = 80.0


# Width of a pad over the side, standard deviation of a bell: that of a block over a tenth of the side.
_PAD = 0.03


def _support(pads: float | None, problem: Problem, facts: PlateFacts) -> Problem:
    """K += integral of k w^2, k = (2 pi f_r)^2 rho h on average: even foam makes f^2 + f_r^2 of f^2.

    pads : distance of the centres of four pads from the edges, over the sides; None for even foam
    """
    del facts
    pad = None if pads is None else Twins(Bell(pads, _PAD))
    form = Form(Atom("w"), Atom("w"), weight=None if pad is None else Product(pad, pad))
    area = 1.0 if pad is None else 2.0 * np.pi * (2.0 * _PAD) ** 2
    supported = replace(problem, supported=True)
    return supported.with_terms(Term("support", "stiffness", (form,), partial(_foam, area)))


def _foam(area: float, state: PlateState, values: Values) -> Array:
    omega = 2 * np.pi * np.asarray(values["support_frequency"])
    return np.asarray(omega**2 * state.density * state.thickness * state.area / area)[..., None]


def _is_free(facts: PlateFacts) -> bool:
    return facts.edges == ALL_FREE


def _per_first_frequency(facts: PlateFacts) -> float:
    """Size factor for a tenth of the first frequency, as modal tests ask of a suspension, half at most."""
    return (facts.first_frequency or _TYPICAL) / _TYPICAL


_FOAM = Effect(
    name="support",
    title="stiff suspension or foam",
    family="surroundings",
    belongs_to="plate",
    parameters=(one_sided("support_frequency", "Hz", 8.0, 40.0),),
    note=(
        "f^2 + f_r^2 on even foam, free plates only: the lowest modes rise most; or, as stiff in all, four "
        "pads a quarter of the sides from the edges"
    ),
    check="Measure the frequency at which the plate bounces on its support, or support it more softly.",
    change=partial(_support, None),
    applies_to=_is_free,
    size_factor=_per_first_frequency,
    sign=1,
    even=True,
    form_error=0.16,
)
# Pads are placed near the nodal lines of the lowest modes.
SUPPORT = replace(
    _FOAM,
    variant="even",
    alternatives=(
        replace(_FOAM, change=partial(_support, 0.25), variant="four pads, 0.25 of the sides from the edges"),
    ),
)
