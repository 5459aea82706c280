"""What an effect is: a record with a pure function from a problem to a problem."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Literal, Protocol

import numpy as np

from cpam_bayes.mechanics.problem import Array, PlateState, Problem, StateFunction, Values
from cpam_bayes.parameters import Parameter, ParameterSet, ScaledStudentT
from cpam_bayes.plate.layup import Layup

Kind = Literal["terms", "coefficients", "observation"]
Stage = Literal["problem", "frequencies", "pairing", "noise"]
# Reference coordinates of a mass or a flaw.
Place = tuple[float, float]

# Prior of an effect: Student-t with this many degrees of freedom, cut where the description ends or
# at this many scales, beyond which 0.13 % of it would lie.
DEGREES_OF_FREEDOM = 4.0
_CUT = 8.0


class PlateLike(Protocol):
    """What of a measured plate an effect asks for; ``measurement.records.Plate`` is one."""

    @property
    def length(self) -> float: ...  # noqa: D102
    @property
    def width(self) -> float: ...  # noqa: D102
    @property
    def thickness(self) -> float: ...  # noqa: D102
    @property
    def layup(self) -> Layup: ...  # noqa: D102
    @property
    def edges(self) -> str: ...  # noqa: D102


@dataclass(frozen=True, slots=True)
class PlateFacts:
    """What of a plate decides which effects it may have, and where.

    length, width, thickness : m. edges : four of F, S, C. loaded : whether known masses break its
    symmetries.
    """

    length: float
    width: float
    thickness: float
    layup: Layup
    edges: str
    isotropic: bool
    loaded: bool = False

    @classmethod
    def of(cls, plate: PlateLike, isotropic: bool, loaded: bool = False) -> PlateFacts:
        """The facts of a measured plate."""
        return cls(plate.length, plate.width, plate.thickness, plate.layup, plate.edges, isotropic, loaded)


def _always(facts: PlateFacts) -> bool:
    del facts
    return True


@dataclass(frozen=True, slots=True)
class Effect:
    """Something that a plate model may lack.

    name : the cause, as in answers. variant : tells effects of one cause apart, by place for instance.
    family : causes of one family share a prior probability. kind : what of the description changes.
    parameters : with unit, prior and null. change : Problem -> Problem with the parameters' values in
    its state or terms. observe : frequencies (..., n_modes) and values (...) -> frequencies, for what
    is not of the plate. stage : who acts on it; "pairing" and "noise" belong to the comparison with
    the measured list and have neither function. even : the frequencies' slope at the null is zero
    on plates that have the symmetries of a free orthotropic rectangle. places, at : where it may be,
    and the effect there. note : one sentence on what it is like.
    """

    name: str
    family: str
    kind: Kind
    parameters: tuple[Parameter, ...]
    note: str
    change: Callable[[Problem, PlateFacts], Problem] | None = None
    observe: Callable[[Array, Values], Array] | None = None
    stage: Stage = "problem"
    applies_to: Callable[[PlateFacts], bool] = _always
    even: bool = False
    absorbed: bool = False
    variant: str = ""
    place: Place | None = None
    places: tuple[Place, ...] = ()
    at: Callable[[Place], Effect] | None = None

    @property
    def parameter_set(self) -> ParameterSet:
        """Its parameters as a set."""
        return ParameterSet(self.parameters)

    @property
    def null(self) -> dict[str, float]:
        """The values that give back the plain model."""
        return {p.name: 0.0 if p.null is None else p.null for p in self.parameters}

    def scaled(self, sds: float) -> dict[str, float]:
        """Values that lie ``sds`` catalogue standard deviations from the null."""
        null = self.null
        return {p.name: null[p.name] + sds * scale_of(p) for p in self.parameters}


def scale_of(parameter: Parameter) -> float:
    """One standard deviation of the catalogue in the parameter's unit; what is known: its prior mean."""
    prior = parameter.prior
    return prior.scale if isinstance(prior, ScaledStudentT) else prior.mean


def extend(problem: Problem, effect: Effect, facts: PlateFacts) -> Problem:
    """The problem with an effect, its parameters appended to the problem's.

    Raises ``ValueError`` where the plate cannot have it, and for an effect that is not of the plate.
    """
    if not effect.applies_to(facts):
        raise ValueError(
            f"effect {effect.name}: not possible on a plate with edges {facts.edges} and layup "
            f"{facts.layup.text}; applicable(facts) lists those that are"
        )
    if effect.change is None:
        raise ValueError(
            f"effect {effect.name} acts on the {effect.stage}, not on the plate; use its `observe` "
            "or the comparison with the measured list"
        )
    changed = effect.change(problem, facts)
    return replace(changed, parameters=problem.parameters.union(effect.parameter_set))


def variants(effect: Effect, facts: PlateFacts) -> tuple[Effect, ...]:
    """The effect at every place where this plate would tell it from the others, or itself.

    A place that the plate's own symmetries map on an earlier one is left out, and one that an edge
    holds.
    """
    if effect.at is None:
        return (effect,)
    seen: set[Place] = set()
    found = []
    for place in effect.places:
        if place in seen or _is_held(place, facts):
            continue
        seen.update(_images(place, facts))
        found.append(effect.at(place))
    return tuple(found)


def widened(effect: Effect, factor: float, ends: Mapping[str, tuple[float, float]] | None = None) -> Effect:
    """The effect with priors wider by a factor: a slip of the pen instead of a tolerance.

    ends : least and largest value by parameter name, where they are not the widened ones.
    """
    found = []
    for p in effect.parameters:
        prior = p.prior
        if not isinstance(prior, ScaledStudentT):
            found.append(p)
            continue
        low, high = (ends or {}).get(p.name, (factor * prior.lower, factor * prior.upper))
        wide = ScaledStudentT(factor * prior.scale, prior.degrees_of_freedom, low, high)
        found.append(replace(p, prior=wide))
    return replace(effect, parameters=tuple(found), variant=" ".join(filter(None, (effect.variant, "gross"))))


def either_sign(name: str, unit: str, scale: float, end: float | None = None) -> Parameter:
    """A parameter of either sign with the catalogue's prior."""
    end = _CUT * scale if end is None else end
    return Parameter(name, unit, ScaledStudentT(scale, DEGREES_OF_FREEDOM, -end, end), null=0.0)


def one_sided(name: str, unit: str, scale: float, end: float | None = None) -> Parameter:
    """A parameter that can only add, with the catalogue's prior."""
    end = _CUT * scale if end is None else end
    return Parameter(name, unit, ScaledStudentT(scale, DEGREES_OF_FREEDOM, 0.0, end), null=0.0)


def with_state(problem: Problem, change: Callable[[PlateState, Values], PlateState]) -> Problem:
    """The problem whose plate's numbers are changed before coefficients are made of them.

    ``change`` is a function of a module, or a partial of one: problems are sent to other processes.
    """
    return replace(problem, state=partial(_changed, problem.state, change))


def _changed(
    before: StateFunction, change: Callable[[PlateState, Values], PlateState], values: Values
) -> PlateState:
    return change(before(values), values)


def stacked(*columns: Any) -> Array:
    """Coefficients (..., n) from n numbers or arrays (...)."""
    return np.stack(np.broadcast_arrays(*columns), axis=-1)


def _is_held(place: Place, facts: PlateFacts) -> bool:
    levels = zip(facts.edges, (place[0], place[1], 1.0 - place[0], 1.0 - place[1]), strict=True)
    return any(edge != "F" and level < 1e-12 for edge, level in levels)


def _images(place: Place, facts: PlateFacts) -> set[Place]:
    """Where the symmetries of the bare plate take a place."""
    x, y = place
    mirrored: Place = (round(1.0 - x, 12), y)
    flipped: Place = (x, round(1.0 - y, 12))
    turned: Place = (mirrored[0], flipped[1])
    if facts.loaded:
        return {place}
    in_x, in_y = facts.edges[0] == facts.edges[2], facts.edges[1] == facts.edges[3]
    angles = facts.layup.angles_deg
    straight = facts.isotropic or bool(np.all(np.isin(np.abs(angles), (0.0, 90.0))))
    found = {place}
    if in_x and in_y:
        found.add(turned)
    if straight and in_x:
        found.add(mirrored)
    if straight and in_y:
        found.add(flipped)
    return found
