"""Which causes are compared on a plate, and how probable each is beforehand."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

from cpam_bayes.effects import GROSS, Effect, PlateFacts, applicable, variants
from cpam_bayes.effects.effect import either_sign, one_sided
from cpam_bayes.parameters import Parameter

NONE, OTHER, PAIR, MATERIAL = "none", "other", "pair", "material"

# Prior probabilities: that nothing is wrong, that something is which no cause describes, that two causes
# act at once; the rest is shared out evenly over the families, and in a family over its causes.
P_NONE, P_OTHER, P_PAIR = 0.50, 0.05, 0.02
# Share of a cause's probability that its gross variant has: a slip of the pen, not a tolerance.
_GROSS_SHARE = 0.1
# Shares of what may be wrong with a list: one mode missed or one false peak, and two modes missed.
_TWO_SHARE = 0.1
# Relative error of a frequency that is misread, and scatter of all modes that nothing explains.
SLIP = either_sign("misreading", "", 0.05, end=0.6)
DISCREPANCY = one_sided("discrepancy", "", 0.02, end=0.3)


@dataclass(frozen=True, slots=True)
class ListChange:
    """What is wrong with a list: model modes that it lacks, a frequency that is no mode or is misread.

    missed : numbers of model modes. spurious, misread : numbers of listed frequencies. A frequency that is
    no mode and a mode that is lacking are one that is so far misread that it stands in another place.
    """

    missed: tuple[int, ...] = ()
    spurious: int | None = None
    misread: int | None = None


@dataclass(frozen=True, slots=True)
class Hypothesis:
    """One way in which the model may be wrong.

    cause : its name in answers; several variants may share it. family : causes of one family share a
    prior probability. effects : of the plate, with their parameters. listed : of the list. parameters :
    of all of these. prior : probability of this variant. other_material : whether the reference constants
    are those of something else, so that only the search bounds are left of what is known of them.
    """

    cause: str
    family: str
    variant: str = ""
    effects: tuple[Effect, ...] = ()
    listed: ListChange = ListChange()
    parameters: tuple[Parameter, ...] = ()
    prior: float = 0.0
    other_material: bool = False

    @property
    def causes(self) -> tuple[str, ...]:
        """The causes that act: one, two of a pair, none."""
        if self.cause in (NONE, OTHER):
            return ()
        # not the effects' names: causes of the list have no effect of the plate
        return tuple(self.cause.split(" + "))

    @property
    def is_gross(self) -> bool:
        """Whether it is a slip of the pen or of the print."""
        return "gross" in self.variant or self.other_material


Kind = Literal["none", "other", "single", "pair"]


def single_hypotheses(
    facts: PlateFacts,
    n_listed: int,
    *,
    complete: bool,
    air_is_known: bool,
    references_have_sd: bool = False,
) -> tuple[Hypothesis, ...]:
    """None, other and every single cause that a plate with a list of so many frequencies may have."""
    found = [Hypothesis(NONE, NONE, prior=P_NONE)]
    found.append(Hypothesis(OTHER, OTHER, parameters=(DISCREPANCY,), prior=P_OTHER))
    by_family: dict[str, dict[str, list[tuple[Hypothesis, float]]]] = defaultdict(lambda: defaultdict(list))
    possible = [e for e in applicable(facts) if not (e.name == "air" and air_is_known)]
    gross = {e.name: e for e in applicable(facts, GROSS)}
    for effect in possible:
        causes = by_family[effect.family][effect.name]
        if effect.stage in ("pairing", "noise"):
            causes += _of_list(effect, n_listed, complete)
            continue
        places = variants(effect, facts)
        wide = gross.get(effect.name)
        share = (1.0 - (_GROSS_SHARE if wide else 0.0)) / len(places)
        causes += [(_of_effect(e), share) for e in places]
        if wide:
            causes.append((_of_effect(wide), _GROSS_SHARE))
    families = {name: causes for name, causes in by_family.items() if any(causes.values())}
    whole = 1.0 - P_NONE - P_OTHER - P_PAIR
    for causes_of in families.values():
        filled = {name: list_ for name, list_ in causes_of.items() if list_}
        for entries in filled.values():
            own = whole / len(families) / len(filled)
            total = sum(share for _, share in entries)
            found += [replace(h, prior=own * share / total) for h, share in entries]
    if references_have_sd:  # a slip like those of the sizes, and as probable as the most probable of these
        slip = max((h.prior for h in found if h.is_gross), default=_GROSS_SHARE * whole / len(families))
        found.append(Hypothesis(MATERIAL, MATERIAL, prior=slip, other_material=True))
    return tuple(found)


def with_prior_of_none(
    hypotheses: Sequence[tuple[Hypothesis, tuple[int, ...]]], prior: float
) -> list[tuple[Hypothesis, tuple[int, ...]]]:
    """The same hypotheses with another probability of none, all others in their proportions.

    Raises ``ValueError`` for a probability that is not above 0 and below 1.
    """
    if not 0.0 < prior < 1.0:
        raise ValueError(f"prior of none: received {prior:g}, accepted: above 0 and below 1")
    others = (1.0 - prior) / (1.0 - P_NONE)
    return [
        (replace(h, prior=prior if h.cause == NONE else others * h.prior), plates) for h, plates in hypotheses
    ]


def prior_by_cause(hypotheses: Sequence[Hypothesis]) -> dict[str, float]:
    """Prior probability of each cause, its variants summed."""
    found: dict[str, float] = defaultdict(float)
    for h in hypotheses:
        found[h.cause] += h.prior
    return dict(found)


def pair_scale(singles: Sequence[Hypothesis]) -> float:
    """Prior of a pair over the product of the priors of its causes."""
    by_cause = prior_by_cause([h for h in singles if h.cause not in (NONE, OTHER)])
    none = next((h.prior for h in singles if h.cause == NONE), P_NONE)
    total = sum(by_cause.values())
    every = 0.5 * (total**2 - sum(p**2 for p in by_cause.values()))
    return P_PAIR * (1.0 - none) / (1.0 - P_NONE) / every if every > 0.0 else 0.0


def paired(a: Hypothesis, b: Hypothesis, scale: float) -> Hypothesis:
    """Two causes that act at once, with the prior of ``pair_scale``."""
    return Hypothesis(
        cause=f"{a.cause} + {b.cause}",
        family=PAIR,
        variant=" / ".join(v for v in (a.variant, b.variant) if v),
        effects=a.effects + b.effects,
        listed=_both(a.listed, b.listed),
        parameters=a.parameters + b.parameters,
        prior=scale * a.prior * b.prior,
    )


def _of_effect(effect: Effect) -> Hypothesis:
    return Hypothesis(effect.name, effect.family, effect.variant, (effect,), parameters=effect.parameters)


def _of_list(effect: Effect, n: int, complete: bool) -> list[tuple[Hypothesis, float]]:
    """Variants of a cause that concerns the list: which mode or frequency it is."""
    if effect.name == "outlier":
        return _misread(effect, n, complete)
    if not complete:  # skipped modes are part of the model of an incomplete list
        return []
    one = [(ListChange(missed=(k,)), f"mode {k + 1} missed") for k in range(n)]
    one += [(ListChange(spurious=i), f"frequency {i + 1} false") for i in range(n)]
    two = [
        (ListChange(missed=(j, k)), f"modes {j + 1} and {k + 1} missed")
        for j in range(n + 1)
        for k in range(j + 1, n + 1)
    ]
    shares = [(1.0 - _TWO_SHARE) / len(one)] * len(one) + [_TWO_SHARE / len(two)] * len(two)
    return [
        (Hypothesis(effect.name, effect.family, variant, listed=change), share)
        for (change, variant), share in zip(one + two, shares, strict=True)
    ]


def _misread(effect: Effect, n: int, complete: bool) -> list[tuple[Hypothesis, float]]:
    """One frequency that is misread and keeps its place, or that a slip of the pen has moved to another.

    A list is sorted: a frequency that is typed far off stands where another mode would, and says nothing.
    """
    in_place = [
        Hypothesis(
            effect.name,
            effect.family,
            f"frequency {i + 1}",
            listed=ListChange(misread=i),
            parameters=(SLIP,),
        )
        for i in range(n)
    ]
    moved = [
        Hypothesis(
            effect.name,
            effect.family,
            f"gross, frequency {i + 1} is mode {k + 1}",
            listed=ListChange(missed=(k,), spurious=i),
        )
        for k in range(n)
        for i in range(n)
        if i != k and complete
    ]
    gross = _GROSS_SHARE if moved else 0.0
    found = [(h, (1.0 - gross) / n) for h in in_place]
    return found + [(h, gross / len(moved)) for h in moved]


def go_together(a: Hypothesis, b: Hypothesis) -> bool:
    """Whether two causes can act at once: not two of the clamp or of the list, nor another material.

    Where the constants may be anything, what else may be wrong is for another diagnosis to say.
    """
    if a.cause == b.cause or a.other_material or b.other_material:
        return False
    clamp = sum(h.family == "clamp" and h.cause != "clamp_length" for h in (a, b))
    of_list = sum(h.listed != ListChange() for h in (a, b))
    return clamp < 2 and of_list < 2


def _both(a: ListChange, b: ListChange) -> ListChange:
    return b if a == ListChange() else a
