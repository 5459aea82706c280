"""Hypotheses about a plate: the causes with their prior probabilities, and the rules of a claim."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Final, Literal

import numpy as np

from cpam_bayes.effects import CATALOGUE, Effect, ListChange, PlateFacts, applicable, variants
from cpam_bayes.effects.effect import GROSS_FRACTION, PERCENT, one_sided
from cpam_bayes.parameters import Parameter

NONE, OTHER, SET = "none", "other", "set"
# Separator between the names of causes that act together.
_TOGETHER = " + "

# Prior probabilities: nothing is wrong, an error that no cause describes, so many causes at once; the rest is
# divided evenly over the families, and in a family over its causes. Beside any causes an unexplained
# discrepancy is as probable as beside none.
P_NONE, P_OTHER = 0.50, 0.05
P_SETS: Final[Mapping[int, float]] = {2: 0.055, 3: 0.015}
P_SINGLE = 1.0 - P_NONE - P_OTHER - sum(P_SETS.values())
_LEFTOVER = P_OTHER / (P_NONE + P_OTHER)
_NO_ERROR = ListChange()
# Unexplained relative scatter of all modes.
DISCREPANCY = one_sided("discrepancy", "", 0.01, end=0.5, shown=PERCENT)
# Its correlation lengths over ln f: white, or an error of the model that changes slowly from mode to mode
# (Kennedy and O'Hagan, J. R. Statist. Soc. B 63, 2001).
CORRELATION_LENGTHS = {"white": 0.0, "smooth, over 0.25 in ln f": 0.25, "smooth, over 0.8 in ln f": 0.8}


@dataclass(frozen=True, slots=True)
class Hypothesis:
    """One way in which the model may be wrong.

    cause : its name in answers; several variants may have the same one
    family : causes of one family divide a prior probability
    effects : on the plate or on its frequencies, with their parameters
    listed : error in the frequency list
    parameters : of all effects and of the list error
    prior : probability of this variant
    unmodelled : effects without a model: on the list, or on the knowledge of the constants
    correlation_length : of the unexplained discrepancy over ln f, 0 where it is white; None without one
    parts : single causes of a set; empty for a single cause
    """

    cause: str
    family: str
    variant: str = ""
    effects: tuple[Effect, ...] = ()
    listed: ListChange = _NO_ERROR
    parameters: tuple[Parameter, ...] = ()
    prior: float = 0.0
    unmodelled: tuple[Effect, ...] = ()
    correlation_length: float | None = None
    parts: tuple[Hypothesis, ...] = ()

    @property
    def instances(self) -> tuple[Hypothesis, ...]:
        """Hypotheses of the single causes of a set; otherwise the hypothesis itself."""
        return self.parts or (self,)

    @property
    def records(self) -> tuple[Effect, ...]:
        """All effects, with or without a model."""
        return self.effects + self.unmodelled

    @property
    def causes(self) -> tuple[str, ...]:
        """Names of the causes that act."""
        return () if self.cause in (NONE, OTHER) else causes_in(self.cause)

    @property
    def may_repeat(self) -> bool:
        """Whether it may act twice: masses or flaws at two places, two misread frequencies."""
        return len(self.records) == 1 and (bool(self.listed.misread) or self.records[0].is_anywhere)

    @property
    def has_leftover(self) -> bool:
        """Whether it has causes and an unexplained discrepancy beside them."""
        return self.correlation_length is not None and self.cause != OTHER

    @property
    def coordinates(self) -> frozenset[str]:
        """Names of the parameters for the place or direction of its effects."""
        return frozenset(p.name for e in self.effects for p in e.coordinates)

    @property
    def smooth(self) -> frozenset[str]:
        """Names of the parameters that Laplace's method integrates well even where they are left open."""
        return frozenset(name for e in self.effects for name in e.smooth)

    @property
    def other_material(self) -> bool:
        """Whether it is another material: only the search bounds of the constants are known."""
        return any(e.drops_references for e in self.unmodelled)

    @property
    def is_gross(self) -> bool:
        """Whether it is a transcription error: a frequency in another's place, or another material."""
        in_anothers_place = bool(self.listed.missed) and self.listed.spurious is not None
        return in_anothers_place or self.other_material

    @property
    def is_of_one_test(self) -> bool:
        """Whether it belongs to one test of a specimen: its clamp or its list."""
        return any(e.belongs_to == "test" for e in self.records)


def causes_in(name: str) -> tuple[str, ...]:
    """Names of the single causes in the name of a cause or set."""
    return tuple(name.split(_TOGETHER))


def single_hypotheses(
    facts: PlateFacts, n_listed: int, *, complete: bool, catalogue: tuple[Effect, ...] = CATALOGUE
) -> tuple[Hypothesis, ...]:
    """None, other and every single cause possible for a plate with ``n_listed`` frequencies."""
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
    whole = P_SINGLE / max(len(families), 1)
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


def with_leftover(hypothesis: Hypothesis) -> tuple[Hypothesis, tuple[Hypothesis, ...]]:
    """The hypothesis without a discrepancy, and its variants with each form of a discrepancy."""
    beside = tuple(
        replace(
            hypothesis,
            variant=f"{hypothesis.variant} with a leftover, {form}".lstrip(),
            prior=_LEFTOVER * hypothesis.prior / len(CORRELATION_LENGTHS),
            correlation_length=length,
        )
        for form, length in CORRELATION_LENGTHS.items()
    )
    return replace(hypothesis, prior=(1.0 - _LEFTOVER) * hypothesis.prior), beside


def with_prior_of_none(
    hypotheses: Sequence[tuple[Hypothesis, tuple[int, ...]]], prior: float
) -> list[tuple[Hypothesis, tuple[int, ...]]]:
    """Hypotheses with another prior of none, all others rescaled in proportion.

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


def set_scales(singles: Sequence[Hypothesis]) -> dict[int, float]:
    """Prior of a set over the product of the priors of its causes, by number of causes.

    P(k) / e_k, e_k the sum of these products over all sets of k causes.
    """
    by_cause = prior_by_cause([h for h in singles if h.cause not in (NONE, OTHER)])
    none = next((h.prior for h in singles if h.cause == NONE), P_NONE)
    products = np.ones(1)
    for p in by_cause.values():
        products = np.append(products, 0.0) + p * np.append(0.0, products)
    rest = (1.0 - none) / (1.0 - P_NONE)
    return {k: rest * p / products[k] if len(products) > k else 0.0 for k, p in P_SETS.items()}


def repeated(hypothesis: Hypothesis) -> Hypothesis:
    """Hypothesis of a second effect of the same cause."""
    (effect,) = hypothesis.records
    second = effect.again()
    of_plate, unmodelled = ((second,), ()) if hypothesis.effects else ((), (second,))
    changed = replace(hypothesis, cause=second.name, parameters=second.parameters)
    return replace(changed, effects=of_plate, unmodelled=unmodelled)


def together(causes: Sequence[Hypothesis], scales: Mapping[int, float]) -> Hypothesis:
    """Set of causes that act together, in any order, with the prior of ``set_scales``."""
    parts = tuple(sorted((i for h in causes for i in h.instances), key=lambda h: (h.cause, h.variant)))
    return Hypothesis(
        cause=_TOGETHER.join(h.cause for h in parts),
        family=SET,
        variant=" / ".join(h.variant for h in parts if h.variant),
        effects=tuple(e for h in parts for e in h.effects),
        listed=_both([h.listed for h in parts if h.listed != _NO_ERROR]),
        parameters=tuple(p for h in parts for p in h.parameters),
        prior=scales[len(parts)] * float(np.prod([h.prior for h in parts])),
        unmodelled=tuple(e for h in parts for e in h.unmodelled),
        parts=parts,
    )


def _both(errors: Sequence[ListChange]) -> ListChange:
    """Combined error of one list: none, one, or several misread frequencies."""
    if len(errors) < 2:
        return errors[0] if errors else _NO_ERROR
    return ListChange(misread=tuple(i for error in errors for i in error.misread))


def _of_plate(effect: Effect, facts: PlateFacts) -> list[tuple[Hypothesis, float]]:
    """Variants of an effect on a plate, one for each place, with their fractions."""
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
                parameters=effect.parameters if variant.change.misread else (),
                unmodelled=(effect,),
            ),
            variant.fraction,
        )
        for variant in effect.pairings(n, complete)
    ]


def go_together(*causes: Hypothesis) -> bool:
    """Whether causes can act together: none excludes another, several errors of a list are all misreadings.

    A second effect needs the first one of its cause, and a second misread frequency is the higher one.
    """
    each = [h for cause in causes for h in cause.instances]
    if len({h.cause for h in each}) < len(each) or any(h.other_material for h in each):
        return False
    errors = [h.listed for h in sorted(each, key=lambda h: h.cause) if h.listed != _NO_ERROR]
    misread = [i for error in errors for i in error.misread]
    if len(errors) > 1 and (len(misread) < len(errors) or misread != sorted(set(misread))):
        return False
    records = [e for h in each for e in h.records]
    names = {e.name for e in records}
    if any(e.repeats is not None and e.repeats.name not in names for e in records):
        return False
    return all(x.goes_with(y) for a, b in combinations(each, 2) for x in a.records for y in b.records)


Kind = Literal["none", "named", "class", "pair", "other", "undecided"]


@dataclass(frozen=True, slots=True)
class ClaimRules:
    """Thresholds of a claim.

    sure, plain : least probability that a cause acts, and that nothing is wrong
    clear : least log Bayes factor of the claim over any set without it, so that priors alone claim nothing
    rival : fraction of the leading probability from which a cause less than `clear` behind joins the claim
    beside : inclusion probability from which a cause is reported beside the claim
    negligible : probability below which it does not matter whether a cause explains the lists
    explained : predictive p-value above which a model explains the lists
    halved : largest fraction of the plain model's misfit beyond noise that a cause with a leftover may leave
    most, undecided : most members of a class, and number of causes listed where nothing is decided
    """

    sure: float = 0.9
    plain: float = 0.5
    clear: float = 3.0
    rival: float = 0.01
    beside: float = 0.1
    negligible: float = 1e-3
    explained: float = 1e-3
    halved: float = 0.5
    most: int = 6
    undecided: int = 3


CLAIM_RULES: Final = ClaimRules()


@dataclass(frozen=True, slots=True)
class Claim:
    """A claim with the causes it names and its probability."""

    kind: Kind
    causes: tuple[str, ...]
    probability: float


def claim_of(
    probability: Mapping[str, float],
    log_evidence: Mapping[str, float],
    explains: Callable[[str], bool] = lambda name: True,
    *,
    is_cut_short: bool = False,
    unaccounted: float = 0.0,
) -> Claim:
    """Claim from the probabilities and evidences of all sets of causes.

    probability : of every set of causes, by its name, none and other among them
    log_evidence : of each, its variants averaged over their priors
    explains : whether the model extended by a set explains the lists, or most of their misfit
    is_cut_short : whether hypotheses are missing: then nothing is claimed
    unaccounted : probability of sets that were not weighed, which may all lack the claimed causes

    Nothing is wrong where none has half the probability. Causes that act with 0.9 each, over all sets that
    contain them, are claimed together. Otherwise the fewest causes of which one acts with 0.9 are claimed:
    one is named, up to six are a class. The best set with one of these is 3 nats above every set without: a
    cause that is less far behind joins the class, and where none or other is, nothing is claimed. No cause is
    claimed whose extended model leaves a misfit beyond noise: where such causes and other together hold 0.9,
    other is claimed. The rest is undecided (docs/model_errors.md).
    """
    if is_cut_short:
        return _undecided(probability)
    if probability[NONE] >= CLAIM_RULES.plain and explains(NONE):
        return Claim("none", (), probability[NONE])
    sure = CLAIM_RULES.sure / max(1.0 - unaccounted, 1e-9)
    claim = _several(probability, sure) or _causes(probability, log_evidence, sure)
    if claim is not None and explains(_leading(probability, claim.causes)):
        return claim
    unexplained = [
        c for c in probability if c != OTHER and probability[c] > CLAIM_RULES.negligible and not explains(c)
    ]
    wrong = probability[OTHER] + sum(probability[c] for c in unexplained)
    if wrong >= sure:
        return Claim("other", (), wrong)
    return _undecided(probability)


def _held(name: str) -> frozenset[str]:
    """The causes that act in a hypothesis."""
    return frozenset() if name in (NONE, OTHER) else frozenset(causes_in(name))


def _acting(probability: Mapping[str, float], causes: Collection[str]) -> float:
    """Probability that one of the causes acts."""
    return min(sum(p for name, p in probability.items() if _held(name) & set(causes)), 1.0)


def inclusion_of(probability: Mapping[str, float]) -> dict[str, float]:
    """Probability that each cause acts, over all sets that hold it, the most probable first."""
    causes = dict.fromkeys(c for name in probability if name not in (NONE, OTHER) for c in causes_in(name))
    inclusion = {c: _acting(probability, (c,)) for c in causes}
    return dict(sorted(inclusion.items(), key=lambda item: -item[1]))


def beside(claim: Claim, inclusion: Mapping[str, float]) -> dict[str, float]:
    """Causes that may act beside those that are claimed, with their inclusion probabilities."""
    if claim.kind not in ("named", "class", "pair"):
        return {}
    return {c: p for c, p in inclusion.items() if c not in claim.causes and p >= CLAIM_RULES.beside}


def _leading(probability: Mapping[str, float], causes: Collection[str]) -> str:
    """The most probable set with one of the causes."""
    return max((n for n in probability if _held(n) & set(causes)), key=lambda n: probability[n])


def _undecided(probability: Mapping[str, float]) -> Claim:
    """Undecided claim: the most probable causes, and the probability that one of them acts."""
    causes = tuple(inclusion_of(probability))[: CLAIM_RULES.undecided]
    return Claim("undecided", causes, _acting(probability, causes))


def _several(probability: Mapping[str, float], sure: float) -> Claim | None:
    """Claim of two or more causes that each act with at least probability ``sure``, together."""
    acts = {c for c, p in inclusion_of(probability).items() if p >= sure}
    if len(acts) < 2:
        return None
    acting = sum(p for name, p in probability.items() if acts <= _held(name))
    first = _leading(probability, acts)
    order = [c for c in causes_in(first) if c in acts] + sorted(acts - set(causes_in(first)))
    return Claim("pair", tuple(order), acting)


def _causes(probability: Mapping[str, float], log_evidence: Mapping[str, float], sure: float) -> Claim | None:
    """Claim of the fewest causes of which one acts with ``sure``, and of those only priors speak against."""
    inclusion, members = inclusion_of(probability), list[str]()
    while _acting(probability, members) < sure:
        gains = {c: _acting(probability, (*members, c)) for c in inclusion if c not in members}
        if not gains or len(members) == CLAIM_RULES.most:
            return None
        members.append(max(gains, key=lambda c: gains[c]))
    best = max(log_evidence[name] for name in probability if _held(name) & set(members))
    least = CLAIM_RULES.rival * _acting(probability, members[:1])
    near = [
        n for n, e in log_evidence.items() if best - e < CLAIM_RULES.clear and not _held(n) & set(members)
    ]
    if NONE in near or OTHER in near:
        return None
    rivals = {c for n in near if probability.get(n, 0.0) >= least for c in _held(n)}
    members += [c for c in inclusion if c in rivals]
    members = members[: CLAIM_RULES.most]
    kind: Kind = "named" if len(members) == 1 else "class"
    return Claim(kind, tuple(members), _acting(probability, members))
