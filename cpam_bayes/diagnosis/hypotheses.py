"""Hypotheses about a plate: the causes with their prior probabilities, and the rules of a claim."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final, Literal

from cpam_bayes.effects import (
    CATALOGUE,
    Effect,
    ListChange,
    PlateFacts,
    applicable,
    variants,
)
from cpam_bayes.effects.effect import GROSS_FRACTION, PERCENT, one_sided
from cpam_bayes.parameters import Parameter

NONE, OTHER, PAIR = "none", "other", "pair"
# Between the names of two causes that act at once.
_TOGETHER = " + "

# Prior probabilities: that nothing is wrong, that something is which no cause describes, that two causes
# act at once; the rest is divided evenly over the families, and in a family over its causes.
P_NONE, P_OTHER, P_PAIR = 0.50, 0.05, 0.02
_NO_ERROR = ListChange()
# Scatter of all modes that nothing explains.
DISCREPANCY = one_sided("discrepancy", "", 0.01, end=0.5, shown=PERCENT)
# Over which ratio of frequencies, as a logarithm, it is much the same: white, or an error of the model that
# changes slowly from mode to mode (Kennedy and O'Hagan, J. R. Statist. Soc. B 63, 2001).
CORRELATION_LENGTHS = {"white": 0.0, "smooth, over 0.25 in ln f": 0.25, "smooth, over 0.8 in ln f": 0.8}


@dataclass(frozen=True, slots=True)
class Hypothesis:
    """One way in which the model may be wrong.

    cause : its name in answers; several variants may have the same one
    family : causes of one family divide a prior probability
    effects : on the plate or on its frequencies, with their parameters
    listed : error in the frequency list
    parameters : of all of these
    prior : probability of this variant
    unmodelled : effects that have no model: on the list, or on what is known of the constants
    correlation_length : of a discrepancy, over ln f; 0 where it is white
    """

    cause: str
    family: str
    variant: str = ""
    effects: tuple[Effect, ...] = ()
    listed: ListChange = _NO_ERROR
    parameters: tuple[Parameter, ...] = ()
    prior: float = 0.0
    unmodelled: tuple[Effect, ...] = ()
    correlation_length: float = 0.0

    @property
    def records(self) -> tuple[Effect, ...]:
        """The effects that act: one, two of a pair, none."""
        return self.effects + self.unmodelled

    @property
    def causes(self) -> tuple[str, ...]:
        """Names of the causes that act."""
        return () if self.cause in (NONE, OTHER) else causes_in(self.cause)

    @property
    def coordinates(self) -> frozenset[str]:
        """Names of the parameters that say where its effects are or which way they go."""
        return frozenset(p.name for e in self.effects for p in e.coordinates)

    @property
    def smooth(self) -> frozenset[str]:
        """Names of the parameters that Laplace's method integrates well wherever they are left open."""
        return frozenset(name for e in self.effects for name in e.smooth)

    @property
    def other_material(self) -> bool:
        """Whether only the search bounds are known of the constants."""
        return any(e.drops_references for e in self.unmodelled)

    @property
    def is_gross(self) -> bool:
        """Whether it is a transcription error."""
        return "gross" in self.variant or self.other_material

    @property
    def is_of_one_test(self) -> bool:
        """Whether it belongs to one test of a specimen: its clamp or its list."""
        return any(e.belongs_to == "test" for e in self.records)


def causes_in(name: str) -> tuple[str, ...]:
    """The causes that act where one of this name does: two of a pair."""
    return tuple(name.split(_TOGETHER))


def single_hypotheses(
    facts: PlateFacts, n_listed: int, *, complete: bool, catalogue: tuple[Effect, ...] = CATALOGUE
) -> tuple[Hypothesis, ...]:
    """None, other and every single cause that a plate with a list of so many frequencies may have."""
    hypotheses = [Hypothesis(NONE, NONE, prior=P_NONE)]
    hypotheses += [
        Hypothesis(
            OTHER,
            OTHER,
            variant,
            parameters=(DISCREPANCY,),
            prior=P_OTHER / len(CORRELATION_LENGTHS),
            correlation_length=length,
        )
        for variant, length in CORRELATION_LENGTHS.items()
    ]
    possible = applicable(facts, catalogue)
    families: dict[str, list[list[tuple[Hypothesis, float]]]] = defaultdict(list)
    for effect in (e for e in possible if not e.drops_references):
        entries = _of_list(effect, n_listed, complete) if effect.pairings else _of_plate(effect, facts)
        if entries:
            families[effect.family].append(entries)
    whole = (1.0 - P_NONE - P_OTHER - P_PAIR) / max(len(families), 1)
    for causes in families.values():
        for entries in causes:
            prior, total = whole / len(causes), sum(fraction for _, fraction in entries)
            hypotheses += [replace(h, prior=prior * fraction / total) for h, fraction in entries]
    # a gross error alone: constants of the right material have their tolerances in their priors
    gross = GROSS_FRACTION * whole
    hypotheses += [
        Hypothesis(effect.name, effect.family, prior=gross, unmodelled=(effect,))
        for effect in possible
        if effect.drops_references
    ]
    return tuple(hypotheses)


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
    prior: dict[str, float] = defaultdict(float)
    for h in hypotheses:
        prior[h.cause] += h.prior
    return dict(prior)


def pair_scale(singles: Sequence[Hypothesis]) -> float:
    """Prior of a pair over the product of the priors of its causes."""
    by_cause = prior_by_cause([h for h in singles if h.cause not in (NONE, OTHER)])
    none = next((h.prior for h in singles if h.cause == NONE), P_NONE)
    total = sum(by_cause.values())
    every = 0.5 * (total**2 - sum(p**2 for p in by_cause.values()))
    return P_PAIR * (1.0 - none) / (1.0 - P_NONE) / every if every > 0.0 else 0.0


def paired(a: Hypothesis, b: Hypothesis, scale: float) -> Hypothesis:
    """Two causes that act at once, the same whichever is first, with the prior of ``pair_scale``."""
    a, b = sorted((a, b), key=lambda h: (h.cause, h.variant))
    return Hypothesis(
        cause=f"{a.cause}{_TOGETHER}{b.cause}",
        family=PAIR,
        variant=" / ".join(v for v in (a.variant, b.variant) if v),
        effects=a.effects + b.effects,
        listed=_both(a.listed, b.listed),
        parameters=a.parameters + b.parameters,
        prior=scale * a.prior * b.prior,
        unmodelled=a.unmodelled + b.unmodelled,
    )


def _of_plate(effect: Effect, facts: PlateFacts) -> list[tuple[Hypothesis, float]]:
    """Variants of an effect on a plate with their fractions: its places."""
    places = variants(effect, facts)
    return [
        (Hypothesis(e.name, e.family, e.variant, (e,), parameters=e.parameters), 1.0 / len(places))
        for e in places
    ]


def _of_list(effect: Effect, n: int, complete: bool) -> list[tuple[Hypothesis, float]]:
    """Variants of an effect on a frequency list with their fractions."""
    assert effect.pairings is not None
    return [
        (
            Hypothesis(
                effect.name,
                effect.family,
                variant.text,
                listed=variant.change,
                parameters=() if variant.change.misread is None else effect.parameters,
                unmodelled=(effect,),
            ),
            variant.fraction,
        )
        for variant in effect.pairings(n, complete)
    ]


def go_together(a: Hypothesis, b: Hypothesis) -> bool:
    """Whether two causes can act together: not what excludes each other, and one error of the list only.

    Where the constants may be anything, what else may be wrong is for another diagnosis to say.
    """
    if a.cause == b.cause or a.other_material or b.other_material:
        return False
    if _NO_ERROR not in (a.listed, b.listed):
        return False
    return all(x.goes_with(y) for x in a.records for y in b.records)


def _both(a: ListChange, b: ListChange) -> ListChange:
    return b if a == _NO_ERROR else a


Kind = Literal["none", "named", "class", "pair", "other", "undecided"]


@dataclass(frozen=True, slots=True)
class ClaimRules:
    """When something is claimed.

    sure : least probability that a cause acts, plain : of nothing wrong
    clear : least log Bayes factor of what is claimed over whatever is without it, so that priors alone claim
        nothing
    rival : fraction of the leading probability from which a cause that is not so far behind joins the claim
    beside : fraction of a claim's probability from which it is told that something else may act beside it
    negligible : probability below which it does not matter whether a cause explains the lists
    most, undecided : members of a class at most, and causes listed where nothing is decided
    """

    sure: float = 0.9
    plain: float = 0.5
    clear: float = 3.0
    rival: float = 0.01
    beside: float = 0.1
    negligible: float = 1e-3
    most: int = 6
    undecided: int = 3


CLAIM_RULES: Final = ClaimRules()


@dataclass(frozen=True, slots=True)
class Claim:
    """The claim, the causes that it names and its probability."""

    kind: Kind
    causes: tuple[str, ...]
    probability: float


def claim_of(
    probability: Mapping[str, float],
    log_evidence: Mapping[str, float],
    pairs: Mapping[str, tuple[str, ...]],
    explains: Callable[[str], bool] = lambda name: True,
    *,
    is_cut_short: bool = False,
) -> Claim:
    """The claim.

    probability : of every cause, of pairs, none and other
    log_evidence : of each, its variants averaged over their priors
    pairs : by name, the two causes of each pair
    explains : whether the model extended by a cause or a pair explains the lists
    is_cut_short : whether hypotheses are missing: then nothing is claimed

    Nothing is wrong where none has half the probability. A cause acts with the probability of all hypotheses
    that hold it, alone or in pairs. Two causes that act with 0.9 each are a pair. Else the fewest causes are
    claimed of which one acts with 0.9: one is named, up to six are a class, whether or not they look alike.
    What is claimed is 3 nats above every hypothesis without it: a cause that is not so far behind joins the
    class, and where none or other is not, nothing is claimed. No cause is claimed whose extended model leaves
    a misfit that is no noise: where those that explain nothing hold 0.9 with other, it is other. The rest is
    undecided.
    """
    if is_cut_short:
        return _undecided(probability, pairs)
    if probability[NONE] >= CLAIM_RULES.plain and explains(NONE):
        return Claim("none", (), probability[NONE])
    claim = _pair(probability, pairs) or _causes(probability, log_evidence, pairs)
    if claim is not None and explains(_leading(probability, pairs, claim.causes)):
        return claim
    unexplained = [
        c for c in probability if c != OTHER and probability[c] > CLAIM_RULES.negligible and not explains(c)
    ]
    wrong = probability[OTHER] + sum(probability[c] for c in unexplained)
    if wrong >= CLAIM_RULES.sure:
        return Claim("other", (), wrong)
    return _undecided(probability, pairs)


def _held(name: str, pairs: Mapping[str, tuple[str, ...]]) -> frozenset[str]:
    """The causes that act in a hypothesis."""
    return frozenset() if name in (NONE, OTHER) else frozenset(pairs.get(name, (name,)))


def _acting(
    probability: Mapping[str, float], pairs: Mapping[str, tuple[str, ...]], causes: Collection[str]
) -> float:
    """Probability that one of the causes acts."""
    return min(sum(p for name, p in probability.items() if _held(name, pairs) & set(causes)), 1.0)


def _ranked(probability: Mapping[str, float], pairs: Mapping[str, tuple[str, ...]]) -> list[str]:
    """All causes, the one that acts with most probability first."""
    causes = dict.fromkeys(c for name in probability for c in pairs.get(name, (name,)))
    every = [c for c in causes if c not in (NONE, OTHER)]
    return sorted(every, key=lambda c: -_acting(probability, pairs, (c,)))


def _leading(
    probability: Mapping[str, float], pairs: Mapping[str, tuple[str, ...]], causes: Collection[str]
) -> str:
    """The most probable hypothesis with one of the causes."""
    return max((n for n in probability if _held(n, pairs) & set(causes)), key=lambda n: probability[n])


def _undecided(probability: Mapping[str, float], pairs: Mapping[str, tuple[str, ...]]) -> Claim:
    """The most probable causes, with the probability that one of them acts; a pair stands for both of its."""
    named = sorted((c for c in probability if c not in (NONE, OTHER)), key=lambda c: -probability[c])
    causes = tuple(dict.fromkeys(c for name in named for c in pairs.get(name, (name,))))
    causes = causes[: CLAIM_RULES.undecided]
    return Claim("undecided", causes, _acting(probability, pairs, causes))


def _pair(probability: Mapping[str, float], pairs: Mapping[str, tuple[str, ...]]) -> Claim | None:
    """Two causes that each act."""
    sure = [c for c in _ranked(probability, pairs) if _acting(probability, pairs, (c,)) >= CLAIM_RULES.sure]
    both = [name for name in pairs if name in probability and set(pairs[name]) <= set(sure)]
    if not both:
        return None
    leading = max(both, key=lambda name: probability[name])
    return Claim("pair", pairs[leading], probability[leading])


def _causes(
    probability: Mapping[str, float],
    log_evidence: Mapping[str, float],
    pairs: Mapping[str, tuple[str, ...]],
) -> Claim | None:
    """The fewest causes of which one acts, with those that only priors speak against."""
    ranked, members = _ranked(probability, pairs), list[str]()
    while _acting(probability, pairs, members) < CLAIM_RULES.sure:
        gains = {c: _acting(probability, pairs, (*members, c)) for c in ranked if c not in members}
        if not gains or len(members) == CLAIM_RULES.most:
            return None
        members.append(max(gains, key=lambda c: gains[c]))
    best = max(log_evidence[name] for name in probability if _held(name, pairs) & set(members))
    least = CLAIM_RULES.rival * _acting(probability, pairs, members[:1])
    # priors of pairs are so low that their evidence may well be the larger one
    near = [n for n, e in log_evidence.items() if n not in pairs and best - e < CLAIM_RULES.clear]
    if NONE in near or OTHER in near:
        return None
    members += [c for c in ranked if c in near and c not in members and probability.get(c, 0.0) >= least]
    members = members[: CLAIM_RULES.most]
    kind: Kind = "named" if len(members) == 1 else "class"
    return Claim(kind, tuple(members), _acting(probability, pairs, members))
