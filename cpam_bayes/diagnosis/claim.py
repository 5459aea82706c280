"""What is claimed of the causes, by fixed rules over their probabilities and signatures."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from cpam_bayes.diagnosis.hypotheses import NONE, OTHER

Kind = Literal["none", "named", "class", "pair", "other", "undecided"]

# Probability from which something is claimed, and from which nothing is.
SURE, PLAIN = 0.9, 0.5
# Log Bayes factor of a class over the best outsider.
CLEAR = 3.0
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
) -> Claim:
    """The claim.

    probability : of every cause, of pairs, none and other. log_evidence : of each, its variants averaged
    over their priors. alike : by cause, the causes that frequencies cannot tell from it. pairs : by name,
    the two causes of each pair.

    Nothing is wrong where none has half the probability. A single cause is named, or its class, where the
    class has 0.9 and its best member is 3 nats above the best outsider, none and other among these; a
    member alone where it has 0.9 itself. Pairs count in the probabilities, with their priors. Then a pair
    is claimed where it and those whose causes cannot be distinguished from its causes have 0.9, or other.
    The rest is undecided.
    """
    if probability[NONE] >= PLAIN:
        return Claim("none", (), probability[NONE])
    singles = [c for c in probability if c not in (NONE, OTHER) and c not in pairs]
    ranked = sorted(singles, key=lambda c: -probability[c])
    if ranked:
        best = ranked[0]
        members = [best, *(c for c in ranked[1:] if c in alike[best])]
        whole = sum(probability[c] for c in members)
        outside = [e for c, e in log_evidence.items() if c not in members and c not in pairs]
        ahead = max(log_evidence[c] for c in members) - max(outside, default=float("-inf"))
        if whole >= SURE and ahead >= CLEAR:
            if probability[best] >= SURE:
                return Claim("named", (best,), probability[best])
            if len(members) <= MOST:
                return Claim("class", tuple(members), whole)
            members = members[:MOST]
            whole = sum(probability[c] for c in members)
            if whole >= SURE:
                return Claim("class", tuple(members), whole)
    if pairs:
        leading = max(pairs, key=lambda name: probability[name])
        whole = sum(probability[name] for name in pairs if _stands_for(pairs[leading], pairs[name], alike))
        if whole >= SURE:
            return Claim("pair", pairs[leading], whole)
    if probability[OTHER] >= SURE:
        return Claim("other", (), probability[OTHER])
    # a pair stands for both of its causes
    named = sorted((c for c in probability if c not in (NONE, OTHER)), key=lambda c: -probability[c])
    causes = tuple(dict.fromkeys(c for name in named for c in pairs.get(name, (name,))))[:UNDECIDED]
    return Claim("undecided", causes, sum(probability[c] for c in causes if c in probability))


def _stands_for(one: tuple[str, ...], other: tuple[str, ...], alike: Mapping[str, frozenset[str]]) -> bool:
    """Whether each cause of a pair is one of the other pair, or cannot be distinguished from it."""

    def is_like(a: str, b: str) -> bool:
        return a == b or b in alike.get(a, frozenset())

    (a, b), (c, d) = one, other
    return (is_like(a, c) and is_like(b, d)) or (is_like(a, d) and is_like(b, c))
