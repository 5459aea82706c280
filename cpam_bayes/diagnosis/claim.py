"""What is claimed of the causes, by fixed rules over their probabilities and signatures."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Literal

from cpam_bayes.diagnosis.hypotheses import NONE, OTHER

Kind = Literal["none", "named", "class", "pair", "other", "undecided"]

# Probability from which something is claimed, and from which nothing is.
SURE, PLAIN = 0.9, 0.5
# Log Bayes factor of a class over the best outsider.
CLEAR = 3.0
# Fraction of the leading cause's probability from which a member of its class is a rival: where the data
# cannot tell them, a ratio of two priors below it is no evidence either.
RIVAL = 0.01
# Fraction of a claim's probability from which it is told that something else may act beside what is claimed.
BESIDE = 0.1
# Probability below which it does not matter whether a cause explains the lists.
_NEGLIGIBLE = 1e-3
# Members of a class at most, and causes listed where nothing is decided.
MOST, UNDECIDED = 6, 3


@dataclass(frozen=True, slots=True)
class Claim:
    """The claim, the causes that it names and its probability."""

    kind: Kind
    causes: tuple[str, ...]
    probability: float


def claim_of(
    probability: Mapping[str, float],
    log_evidence: Mapping[str, float],
    alike: Mapping[str, frozenset[str]],
    pairs: Mapping[str, tuple[str, ...]],
    explains: Callable[[str], bool] = lambda name: True,
    *,
    is_cut_short: bool = False,
) -> Claim:
    """The claim.

    probability : of every cause, of pairs, none and other
    log_evidence : of each, its variants averaged over their priors
    alike : by cause, the causes that frequencies cannot tell from it
    pairs : by name, the two causes of each pair
    explains : whether the model extended by a cause or a pair explains the lists
    is_cut_short : whether hypotheses are missing: then nothing is claimed

    Nothing is wrong where none has half the probability. A cause is claimed with what cannot be told from
    it, where together they have 0.9 and the best of them is 3 nats above the best outsider, none and other
    among these; alone where it has 0.9 itself and the rest of its class have hardly any probability, so that
    priors alone do not decide. Pairs count in the probabilities, with their priors. Then a pair is claimed
    where it has 0.9 itself, or one cause where all hypotheses that contain it, alone or in pairs, have 0.9:
    what acts beside it is open. No cause is
    claimed whose extended model leaves a misfit that is no noise: where those that explain nothing hold 0.9
    with other, it is other. The rest is undecided.
    """
    if is_cut_short:
        return _undecided(probability, pairs)
    if probability[NONE] >= PLAIN and explains(NONE):
        return Claim("none", (), probability[NONE])
    claim = _cause(probability, log_evidence, alike, pairs)
    if claim is not None and explains(claim.causes[0]):
        return claim
    if pairs and explains(_leading(probability, pairs)):
        claim = _pair(probability, pairs) or _one_of_pairs(probability, alike, pairs)
        if claim is not None:
            return claim
    unexplained = [c for c in probability if c != OTHER and probability[c] > _NEGLIGIBLE and not explains(c)]
    wrong = probability[OTHER] + sum(probability[c] for c in unexplained)
    if wrong >= SURE:
        return Claim("other", (), wrong)
    return _undecided(probability, pairs)


def _undecided(probability: Mapping[str, float], pairs: Mapping[str, tuple[str, ...]]) -> Claim:
    """The most probable causes, with the probability that one of them acts; a pair stands for both of its."""
    named = sorted((c for c in probability if c not in (NONE, OTHER)), key=lambda c: -probability[c])
    causes = tuple(dict.fromkeys(c for name in named for c in pairs.get(name, (name,))))[:UNDECIDED]
    whole = sum(probability[name] for name in named if set(causes) & set(pairs.get(name, (name,))))
    return Claim("undecided", causes, whole)


def _cause(
    probability: Mapping[str, float],
    log_evidence: Mapping[str, float],
    alike: Mapping[str, frozenset[str]],
    pairs: Mapping[str, tuple[str, ...]],
) -> Claim | None:
    """One cause or its class."""
    singles = [c for c in probability if c not in (NONE, OTHER) and c not in pairs]
    ranked = sorted(singles, key=lambda c: -probability[c])
    if not ranked:
        return None
    best = ranked[0]
    members = [best, *(c for c in ranked[1:] if c in alike[best])]
    whole = sum(probability[c] for c in members)
    outside = [e for c, e in log_evidence.items() if c not in members and c not in pairs]
    ahead = max(log_evidence[c] for c in members) - max(outside, default=float("-inf"))
    if whole < SURE or ahead < CLEAR:
        return None
    rivals = [c for c in members[1:] if probability[c] >= RIVAL * probability[best]]
    if probability[best] >= SURE and not rivals:
        return Claim("named", (best,), probability[best])
    members = [best, *(rivals or members[1:])][:MOST]
    whole = sum(probability[c] for c in members)
    return Claim("class", tuple(members), whole) if whole >= SURE else None


def _leading(probability: Mapping[str, float], pairs: Mapping[str, tuple[str, ...]]) -> str:
    return max(pairs, key=lambda name: probability[name])


def _pair(probability: Mapping[str, float], pairs: Mapping[str, tuple[str, ...]]) -> Claim | None:
    """The leading pair, where it has the probability itself."""
    leading = _leading(probability, pairs)
    sure = probability[leading] >= SURE
    return Claim("pair", pairs[leading], probability[leading]) if sure else None


def _one_of_pairs(
    probability: Mapping[str, float],
    alike: Mapping[str, frozenset[str]],
    pairs: Mapping[str, tuple[str, ...]],
) -> Claim | None:
    """A cause, or its class, that acts in all that is probable, alone or beside one or another."""
    leading = pairs[_leading(probability, pairs)]
    for classes in ([(c,) for c in leading], [(c, *sorted(alike.get(c, ()))) for c in leading]):
        totals = []
        for members in classes:
            total = sum(p for name, p in probability.items() if set(members) & set(pairs.get(name, (name,))))
            totals.append((total, members))
        total, members = max(totals, key=lambda entry: entry[0])
        if total >= SURE and len(members) <= MOST:
            return Claim("named" if len(members) == 1 else "class", members, min(total, 1.0))
    return None
