"""The record of an effect: all that the package needs to know of a cause.

Effects on a frequency list are here too: missed modes, misread values, frequency scale, loss tangent.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Literal

import numpy as np

from cpam_bayes.mechanics.problem import (
    Array,
    CoefficientFunction,
    PlateState,
    Problem,
    StateFunction,
    Values,
)
from cpam_bayes.parameters import Mixture, Parameter, ParameterSet, Prior, ScaledStudentT, Uniform
from cpam_bayes.plate import Plate
from cpam_bayes.plate.layup import Layup

Owner = Literal["plate", "test", "material", "laboratory"]
# Values of an effect's further parameters: the reference coordinates of a mass or a flaw, its extent.
Place = tuple[float, ...]
# Form of an effect at a free place: a point mass, or a softer patch with a smooth or a sharp edge.
LocalForm = Literal["point", "bell", "rectangle"]

# Prior of an effect: Student-t with this many degrees of freedom, cut where the model ceases to apply or at
# this many scales, beyond which 0.13 % of it would lie.
DEGREES_OF_FREEDOM = 4.0
_CUT = 8.0
# Probability that a size is no tolerance but a gross error: a digit misread, a ply turned by 90 degrees, the
# wrong sheet. Then it has a far wider density, up to the physical limit.
GROSS_FRACTION = 0.1
EVEN = np.inf
# Pattern of the names of a second effect of one cause and of its parameters.
_SECOND = "{}#2"

# How parameters are shown to people: the unit, and the factor from SI.
PERCENT, GRAM, MILLIMETRE = ("%", 100.0), ("g", 1e3), ("mm", 1e3)
MICROMETRE, MEGAPASCAL = ("um", 1e6), ("MPa", 1e-6)


@dataclass(frozen=True, slots=True)
class PlateFacts:
    """The facts of a plate that decide which effects it may have, and where.

    length, width, thickness : m
    mass : kg
    edges : four of F, S, C
    loaded : whether known masses break its symmetries
    air_is_known : whether the model contains the air already
    has_references : whether reference values narrow the priors of the constants
    first_frequency : of the bare plate at its reference constants, Hz, if known
    weighed : whether the mass was measured: it is kept where a size is another one
    loss_factor : measured, median over the modes; None without their damping
    """

    length: float
    width: float
    thickness: float
    layup: Layup
    edges: str
    isotropic: bool
    mass: float
    loaded: bool = False
    air_is_known: bool = False
    has_references: bool = False
    first_frequency: float | None = None
    weighed: bool = False
    loss_factor: float | None = None

    @classmethod
    def of(
        cls,
        plate: Plate,
        isotropic: bool,
        loaded: bool = False,
        air_is_known: bool = False,
        has_references: bool = False,
        first_frequency: float | None = None,
        loss_factor: float | None = None,
    ) -> PlateFacts:
        """Facts of a measured plate."""
        sides = (plate.length, plate.width, plate.thickness)
        mass = plate.density * plate.thickness * plate.area
        known = (loaded, air_is_known, has_references)
        weighed = plate.mass is not None
        return cls(
            *sides, plate.layup, plate.edges, isotropic, mass, *known, first_frequency, weighed, loss_factor
        )


@dataclass(frozen=True, slots=True)
class ListChange:
    """An error in a frequency list.

    A false peak together with a missed mode is a frequency misread so far that it stands in the place of
    another one.

    missed : numbers of the model modes that the list lacks
    spurious : number of the listed frequency that is a false peak
    misread : numbers of the listed frequencies that are 1 + one of ``MISREADINGS`` times the mode's
    """

    missed: tuple[int, ...] = ()
    spurious: int | None = None
    misread: tuple[int, ...] = ()

    @property
    def changes_pairing(self) -> bool:
        """Whether frequencies belong to other modes than in an error-free list."""
        return bool(self.missed) or self.spurious is not None


@dataclass(frozen=True, slots=True)
class ListVariant:
    """One possible error of a list.

    text : name of the variant
    fraction : of the effect's prior probability
    """

    change: ListChange
    text: str
    fraction: float


def _always(facts: PlateFacts) -> bool:
    del facts
    return True


@dataclass(frozen=True, slots=True, kw_only=True)
class Effect:
    """An effect that a plate model or a frequency list may lack.

    Exactly one of ``change``, ``observe``, ``pairings``, ``drops_references`` and ``on_plate`` says what it
    does; what ``on_plate`` gives has ``change`` too.

    name : the cause, as in answers
    title : the cause in words for people
    family : causes of one family divide its prior probability
    belongs_to : "plate": tests of one specimen have it in common, a sister plate need not have it; "test":
        of one list; "material", "laboratory": sister plates have it too
    parameters : with unit, prior, null and display unit; the first is the size, others are place or direction
    note : how it enters the model
    check : what to check in the laboratory, one sentence
    change : Problem -> Problem with the values of the parameters in its state or terms
    observe : frequencies (..., n_modes), values (...) -> frequencies
    pairings : size of a frequency list, whether it is complete -> the possible errors
    drops_references : whether the reference values do not apply to the constants
    applies_to : whether a plate may have it
    size_factor : expected size on a plate over that of the priors in ``parameters``
    sign : of the change of every frequency when the parameter grows, 0 if modes differ
    even : whether the slope of the frequencies at the null is zero on plates that have the symmetries of a
        free orthotropic rectangle
    couples_stretching : whether it couples stretching with bending, for which a symmetric layup's space has
        no functions
    excludes : names of the effects that cannot act together with it
    variant : distinguishes effects of one cause, by form for instance
    place : where it is, if that is fixed
    at : for an effect at a free place, gives the effect at a fixed place; its own ``change`` raises
    local : its form, for an effect at a free place and for the same at a fixed one
    alternatives : other forms of the same cause with the same parameters; those that the plate may have are
        equally probable
    on_plate : its equally probable forms where these follow from the plate, the farthest from it first:
        without parameters, and with the terms of the bare plate, so that one basis serves all
    directions : names of its direction parameters
    repeats : the effect of which it is a second one, None for the first
    edges : numbers of the edges along which it acts, or may act, which a drawing of the plate marks
    drawn : where else it shows on a drawing, "" for an effect on the whole plate
    smooth : names of further parameters that Laplace's method integrates well even where they are left open
    form_error : root-mean-square error of its form in the frequency shifts of a real one, relative to these;
        studies/25_form_errors.py
    """

    name: str
    title: str
    family: str
    belongs_to: Owner
    parameters: tuple[Parameter, ...]
    note: str
    check: str
    change: Callable[[Problem, PlateFacts], Problem] | None = None
    observe: Callable[[Array, Values], Array] | None = None
    pairings: Callable[[int, bool], tuple[ListVariant, ...]] | None = None
    drops_references: bool = False
    on_plate: Callable[[PlateFacts], tuple[Effect, ...]] | None = None
    applies_to: Callable[[PlateFacts], bool] = _always
    size_factor: Callable[[PlateFacts], float] | None = None
    sign: Literal[-1, 0, 1] = 0
    even: bool = False
    couples_stretching: bool = False
    excludes: tuple[str, ...] = ()
    variant: str = ""
    place: Place | None = None
    at: Callable[[Place], Effect] | None = None
    local: LocalForm | None = None
    alternatives: tuple[Effect, ...] = ()
    directions: tuple[str, ...] = ()
    smooth: tuple[str, ...] = ()
    form_error: float = 0.0
    repeats: Effect | None = None
    edges: Callable[[PlateFacts], Sequence[int]] | None = None
    drawn: Literal["", "corner", "corners", "plies"] = ""

    @property
    def parameter_set(self) -> ParameterSet:
        """Its parameters as a set."""
        return ParameterSet(self.parameters)

    @property
    def null(self) -> dict[str, float]:
        """Parameter values that give back the plain model."""
        return {p.name: 0.0 if p.null is None else p.null for p in self.parameters}

    def scaled(self, sds: float) -> dict[str, float]:
        """Parameter values with sizes ``sds`` catalogue standard deviations from the null."""
        null = self.null
        return null | {p.name: null[p.name] + sds * scale_of(p) for p in self.sizes}

    @property
    def coordinates(self) -> tuple[Parameter, ...]:
        """Parameters of its free place, or of its direction."""
        if self.at is not None:
            return self.parameters[1:]
        return tuple(p for p in self.parameters if p.name in self.directions)

    @property
    def sizes(self) -> tuple[Parameter, ...]:
        """Parameters of its size."""
        return tuple(p for p in self.parameters if p not in self.coordinates)

    def fixed(self, values: Values) -> Effect:
        """The effect fixed at the place in these values, its size alone free; itself without a free place."""
        if not self.is_anywhere:
            return self
        assert self.at is not None
        placed = self.at(tuple(float(values[p.name]) for p in self.coordinates))
        return replace(placed, parameters=self.sizes, size_factor=None)

    def again(self) -> Effect:
        """A second effect of the same cause, with its own name and parameters."""
        return replace(
            self,
            name=_SECOND.format(self.name),
            title=f"second {self.title}",
            parameters=tuple(replace(p, name=_SECOND.format(p.name)) for p in self.parameters),
            change=None if self.change is None else partial(_changed_again, self.change),
            at=None if self.at is None else partial(_at_again, self.at),
            smooth=tuple(map(_SECOND.format, self.smooth)),
            repeats=self,
        )

    @property
    def forms(self) -> tuple[Effect, ...]:
        """The effect and its alternatives."""
        return (self, *self.alternatives)

    @property
    def is_anywhere(self) -> bool:
        """Whether its place is among its parameters."""
        return self.at is not None and bool(self.coordinates)

    @property
    def is_common_to_sisters(self) -> bool:
        """Whether a sister plate of the same material in the same laboratory has it too."""
        return self.belongs_to in ("material", "laboratory")

    def goes_with(self, other: Effect) -> bool:
        """Whether the two effects can act together."""
        return other.name not in self.excludes and self.name not in other.excludes


def _changed_again(
    change: Callable[[Problem, PlateFacts], Problem], problem: Problem, facts: PlateFacts
) -> Problem:
    """Problem with a second effect: the terms of the first one, with the parameters of the second."""
    changed = change(problem, facts)
    n = len(problem.terms)
    added = (
        replace(t, name=_SECOND.format(t.name), coefficients=partial(_of_second, t.coefficients))
        for t in changed.terms[n:]
    )
    return replace(changed, terms=(*changed.terms[:n], *added))


def _of_second(coefficients: CoefficientFunction, state: PlateState, values: Values) -> Array:
    ending = _SECOND.format("")
    return coefficients(state, {n.removesuffix(ending): v for n, v in values.items() if n.endswith(ending)})


def _at_again(at: Callable[[Place], Effect], place: Place) -> Effect:
    return at(place).again()


def scale_of(parameter: Parameter) -> float:
    """One catalogue standard deviation in the parameter's unit; of a known quantity, its prior mean."""
    return parameter.prior.typical


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
        if effect.on_plate is not None:
            raise ValueError(f"effect {effect.name}: take one of its forms, variants(effect, facts)")
        acts_on = "frequencies" if effect.observe else "pairing" if effect.pairings else "priors"
        raise ValueError(
            f"effect {effect.name} acts on the {acts_on}, not on the plate; use its `observe` "
            "or the comparison with the measured list"
        )
    changed = effect.change(problem, facts)
    return replace(changed, parameters=problem.parameters.union(effect.parameter_set))


def variants(effect: Effect, facts: PlateFacts) -> tuple[Effect, ...]:
    """Equally probable forms of the effect that a plate may have, with the priors for this plate.

    Places that the plate's symmetries map onto each other are in the prior once.
    """
    every = effect.on_plate(facts) if effect.on_plate else effect.forms
    forms = (replace(form, parameters=effect.parameters, alternatives=()) for form in every)
    return tuple(_for_plate(form, facts) for form in forms if form.applies_to(facts))


def _for_plate(effect: Effect, facts: PlateFacts) -> Effect:
    if effect.size_factor is not None:
        factor = effect.size_factor(facts)
        sizes = tuple(replace(p, prior=p.prior.stretched(factor)) for p in effect.sizes)
        effect = replace(effect, parameters=(*sizes, *effect.coordinates))
    return _on_half_or_quarter(effect, facts) if effect.is_anywhere else effect


def anywhere(problem: Problem, facts: PlateFacts) -> Problem:
    """The ``change`` of an effect at a free place: raises ``ValueError`` until the place is fixed."""
    del problem, facts
    raise ValueError(
        "an effect at any place is no change of the problem; fix its place with effect.at((x, y))"
    )


def coordinate(name: str, lower: float = 0.0) -> Parameter:
    """Reference coordinate, uniform on the plate; lower : above 0 where symmetry halves the plate."""
    return Parameter(name, "", Uniform(lower, 1.0), 0.5 * (lower + 1.0), PERCENT)


def place_text(place: Place) -> str:
    """Text of a place."""
    return f"at ({', '.join(f'{c:.4g}' for c in place)})"


def either_sign(
    name: str,
    unit: str,
    scale: float,
    end: float | tuple[float, float] | None = None,
    *,
    gross: float | None = None,
    shown: tuple[str, float] | None = None,
) -> Parameter:
    """A parameter of either sign with the catalogue's prior.

    end : of the prior, both if not symmetric
    gross : scale of gross errors, ``EVEN`` for a uniform density of these up to the ends
    """
    end = _CUT * scale if end is None else end
    low, high = end if isinstance(end, tuple) else (-end, end)
    return Parameter(name, unit, _prior(scale, gross, low, high), 0.0, shown)


def misstated(
    name: str, scale: float, end: float | tuple[float, float], *, shown: tuple[str, float] = PERCENT
) -> Parameter:
    """Relative gross error of a number in the plate file; its tolerance is in every hypothesis.

    scale, end : of a Student-t, and where it is cut
    """
    low, high = end if isinstance(end, tuple) else (-end, end)
    return Parameter(name, "", ScaledStudentT(scale, DEGREES_OF_FREEDOM, low, high), 0.0, shown)


def one_sided(
    name: str,
    unit: str,
    scale: float,
    end: float | None = None,
    *,
    gross: float | None = None,
    shown: tuple[str, float] | None = None,
) -> Parameter:
    """A non-negative parameter with the catalogue's prior; gross as of ``either_sign``."""
    end = _CUT * scale if end is None else end
    return Parameter(name, unit, _prior(scale, gross, 0.0, end), 0.0, shown)


def per_thickness(facts: PlateFacts) -> float:
    """Factor of sizes that the catalogue gives for a plate of 2 mm and that grow with the thickness."""
    return facts.thickness / 2e-3


def _prior(scale: float, gross: float | None, low: float, high: float) -> Prior:
    tolerance = ScaledStudentT(scale, DEGREES_OF_FREEDOM, low, high)
    if gross is None:
        return tolerance
    wide = Uniform(low, high) if gross == EVEN else ScaledStudentT(gross, DEGREES_OF_FREEDOM, low, high)
    return Mixture(tolerance, wide, GROSS_FRACTION)


def with_state(problem: Problem, change: Callable[[PlateState, Values], PlateState]) -> Problem:
    """Problem whose plate state is changed before its coefficients are computed.

    ``change`` is a module-level function or a partial of one: problems are sent to other processes.
    """
    return replace(problem, state=partial(_changed, problem.state, change))


def _changed(
    before: StateFunction, change: Callable[[PlateState, Values], PlateState], values: Values
) -> PlateState:
    return change(before(values), values)


def stacked(*columns: Any) -> Array:
    """Coefficients (..., n) from n numbers or arrays (...)."""
    return np.stack(np.broadcast_arrays(*columns), axis=-1)


def symmetries(facts: PlateFacts) -> tuple[bool, bool, bool]:
    """Whether mirroring in x, mirroring in y, and a half-turn map a plate onto itself."""
    in_x, in_y = facts.edges[0] == facts.edges[2], facts.edges[1] == facts.edges[3]
    straight = facts.isotropic or bool(np.all(np.isin(np.abs(facts.layup.angles_deg), (0.0, 90.0))))
    own = not facts.loaded
    return own and in_x and straight, own and in_y and straight, own and in_x and in_y


def _on_half_or_quarter(effect: Effect, facts: PlateFacts) -> Effect:
    """The effect with its place restricted to what the plate's symmetries leave, x and y >= 0.5."""
    *mirrored, turned = symmetries(facts)
    # the half-turn alone leaves one half, either one
    halved = [axis for axis in (0, 1) if mirrored[axis]] or [0] * turned
    if not halved:
        return effect
    size, *further = effect.parameters
    for axis in halved:
        further[axis] = coordinate(further[axis].name, 0.5)
    images = "or its mirror images" if any(mirrored) else "or the place turned by half a turn"
    variant = f"{effect.variant}, {images}" if effect.variant else images
    return replace(effect, parameters=(size, *further), variant=variant)


# Relative error of a misread frequency, and of a second one.
MISREADING = either_sign("misreading", "", 0.05, end=0.6, shown=PERCENT)
MISREADINGS = (MISREADING, replace(MISREADING, name=_SECOND.format(MISREADING.name)))
# Fractions of the prior: two modes missed, of the errors of pairing; a frequency in another's place.
_TWO_MISSED, _MOVED = 0.1, 0.1


def _pairings(n: int, complete: bool) -> tuple[ListVariant, ...]:
    """Variants with one mode missed, one false peak or two modes missed; none for an incomplete list."""
    if not complete:
        return ()
    once = [(ListChange(missed=(k,)), f"mode {k + 1} missed") for k in range(n)]
    once += [(ListChange(spurious=i), f"frequency {i + 1} false") for i in range(n)]
    twice = [
        (ListChange(missed=(j, k)), f"modes {j + 1} and {k + 1} missed")
        for j in range(n + 1)
        for k in range(j + 1, n + 1)
    ]
    single = (ListVariant(*entry, (1.0 - _TWO_MISSED) / len(once)) for entry in once)
    return (*single, *(ListVariant(*entry, _TWO_MISSED / len(twice)) for entry in twice))


def _misreadings(n: int, complete: bool) -> tuple[ListVariant, ...]:
    """Variants with one frequency misread in its place, or moved by a transcription error to another place.

    A list is sorted: a frequency typed far off stands in the place of another mode and is uninformative.
    """
    moved = [
        (ListChange(missed=(k,), spurious=i), f"gross, frequency {i + 1} is mode {k + 1}")
        for k in range(n)
        for i in range(n)
        if i != k and complete
    ]
    gross = _MOVED if moved else 0.0
    in_place = [
        ListVariant(ListChange(misread=(i,)), f"frequency {i + 1}", (1.0 - gross) / n) for i in range(n)
    ]
    return (*in_place, *(ListVariant(*entry, gross / len(moved)) for entry in moved))


MODE_IDENTITY = Effect(
    name="mode_identity",
    title="missed, extra or swapped mode",
    family="list",
    belongs_to="test",
    parameters=(),
    note="in the pairing with the model's modes",
    check="Compare the measured mode shapes with the computed ones, and label the frequencies.",
    pairings=_pairings,
)
OUTLIER = Effect(
    name="outlier",
    title="misread frequency",
    family="list",
    belongs_to="test",
    parameters=(MISREADING,),
    note="one frequency is off, so far perhaps that it stands in another place",
    check="Read that peak again in the measured spectrum.",
    pairings=_misreadings,
)


def _scaled(frequencies: Array, values: Values) -> Array:
    """F (1 + s)."""
    return np.asarray(frequencies * (1.0 + np.asarray(values["frequency_deviation"])[..., None]))


def _stiffened(frequencies: Array, values: Values) -> Array:
    """F (f / f_1)^(tan delta / pi): d ln f = (tan delta / pi) ln(f / f_1).

    A material of constant loss tangent stiffens by 2 tan delta / pi per unit of ln f (Kramers and
    Kronig); the constants are those at the first frequency.
    """
    slope = np.asarray(values["loss_tangent"])[..., None] / np.pi
    return np.asarray(frequencies * np.exp(slope * np.log(frequencies / frequencies[..., :1])))


def _measured_loss(facts: PlateFacts) -> float:
    """Measured loss factor, of all losses, over the prior's loss tangent; 1 at most."""
    if facts.loss_factor is None:
        return 1.0
    return min(max(facts.loss_factor, _LEAST_LOSS) / _LOSS_TANGENT, 1.0)


# The least is that of bare aluminium: less is an unresolved decay, and 0 leaves no prior.
_LOSS_TANGENT, _LEAST_LOSS = 0.01, 1e-4
FREQUENCY_SCALE = Effect(
    name="frequency_scale",
    title="wrong frequency scale",
    family="size",
    belongs_to="laboratory",
    parameters=(misstated("frequency_deviation", 0.02, 0.1),),
    note="all frequencies by one factor, after the plate; stiffer moduli would do the same",
    check="Measure the signal of a calibrated generator.",
    observe=_scaled,
    sign=1,
)
VISCOELASTIC = Effect(
    name="viscoelastic",
    title="frequency-dependent stiffness",
    family="damping",
    belongs_to="material",
    parameters=(one_sided("loss_tangent", "", _LOSS_TANGENT, 0.05),),
    note="d ln f = (tan delta / pi) ln(f / f_1), after the plate; 1 sd is the measured loss factor where "
    "that is below 0.01",
    check="Measure the modal damping: the loss tangent is twice the damping ratio.",
    observe=_stiffened,
    size_factor=_measured_loss,
    sign=1,
)
