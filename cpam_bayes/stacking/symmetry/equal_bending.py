"""Different stacking sequences with the same bending stiffness, which the frequencies of a thin plate share.

Where the plies of two sets weigh the same, exchanging what lies in them may leave all four bending
lamination parameters as they are: [0/90/90/45/0/30]_s and [90/0/0/45/90/30]_s, since
6^3 - 5^3 + 2^3 - 1^3 = 5^3 - 3^3. No motion of the plate maps one on the other. Transverse shear still
tells them apart, the less the thinner the plate and the noisier the list.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.stacking.features import PlySums, all_choices
from cpam_bayes.stacking.records import StackingPosterior, StackingProblem
from cpam_bayes.stacking.symmetry.classes import canonical

Array = NDArray[Any]

# Sums of cosines that differ by less are equal.
_EQUAL: Final = 1e-11
# Log Bayes factors, nats, that are smaller say nothing: evidences are known to about as much.
_INDISTINGUISHABLE_NATS: Final = 0.1
# A direction in which sums over the outer and the inner plies are sorted; any that is no special one.
_DIRECTION: Final = np.array([1.0, np.sqrt(2.0), np.sqrt(3.0), np.sqrt(5.0)])


def equal_bending(sums: PlySums, sequences: Array) -> tuple[Array, ...]:
    """All sequences of the grid with the bending lamination parameters of each of (m, k), itself included.

    These are sums over the outer plies and over the inner plies, tabulated for all choices of either.
    """
    k, g = sums.n_unknown, len(sums.grid_deg)
    inner = k - k // 2
    left, right = all_choices(sums.first[: k - inner]), all_choices(sums.first[k - inner :])
    order = np.argsort(right @ _DIRECTION, kind="stable")
    at = (right @ _DIRECTION)[order]
    equal = []
    for target in sums.features(sequences)[:, :4]:
        needed = (target - left) @ _DIRECTION
        begin, end = (np.searchsorted(at, needed + sign * len(_DIRECTION) * _EQUAL) for sign in (-1, 1))
        some = np.flatnonzero(end > begin)
        rows = np.repeat(some, (end - begin)[some])
        columns = order[np.concatenate([np.arange(begin[i], end[i]) for i in some])]
        same = np.all(np.abs(left[rows] + right[columns] - target) < _EQUAL, axis=1)
        whole = rows[same] * g**inner + columns[same]
        equal.append(np.column_stack(np.unravel_index(whole, (g,) * k)))
    return tuple(equal)


def merge_indistinguishable(
    answer: StackingPosterior, problem: StackingProblem, sums: PlySums
) -> StackingPosterior:
    """The posterior with classes of equal bending stiffness noted, and merged where nothing else counts.

    They are merged if the log of their Bayes factor E[p(f | x, s') / p(f | x, s)], over the posterior of the
    constants x of the first, is within ``_INDISTINGUISHABLE_NATS`` of zero.
    """
    sequences = answer.components.sequences
    classes = canonical(sequences, problem.symmetries).representative
    listed_row = {tuple(row): i for i, row in enumerate(classes.tolist())}
    same_bending, alike = list(answer.same_bending), list(answer.alike)
    probability, multiplicity = answer.probability.copy(), answer.multiplicity.copy()
    merged = np.zeros(len(sequences), dtype=bool)
    for i, same in enumerate(equal_bending(sums, sequences)):
        orbits = canonical(same, problem.symmetries)
        others, at = np.unique(orbits.representative, axis=0, return_index=True)
        new = np.any(others != classes[i], axis=1)
        if merged[i] or not new.any():
            continue
        same_bending[i], size = others[new], orbits.size[at][new]
        near = np.abs(_log_bayes_factors(answer, i, same_bending[i])) < _INDISTINGUISHABLE_NATS
        alike[i] = same_bending[i][near]
        rows = [listed_row[key] for key in map(tuple, alike[i].tolist()) if key in listed_row]
        rows = [i, *(row for row in rows if row > i and not merged[row])]
        merged[rows[1:]] = True
        probability[i] = np.average(answer.probability[rows], weights=answer.multiplicity[rows])
        multiplicity[i] += size[near].sum()
    kept = np.flatnonzero(~merged)
    kept = kept[np.lexsort((-answer.log_evidence[kept], -probability[kept]))]
    whole = replace(
        answer,
        same_bending=tuple(same_bending),
        alike=tuple(alike),
        probability=probability,
        multiplicity=multiplicity,
    )
    return whole.listing(kept)


def _log_bayes_factors(answer: StackingPosterior, i: int, others: Array) -> Array:
    """Log Bayes factors of others (m, k) against the listed class ``i`` from draws of its constants, (m,)."""
    x = answer.components.conditionals.draws[i]
    angles = answer.grid_deg[np.vstack((answer.components.sequences[i], others))]
    rows = np.repeat(np.arange(len(angles)), len(x))
    log_p = (
        answer.conditional.at(angles, rows)
        .log_prob(np.tile(x, (len(angles), 1)))
        .reshape(len(angles), len(x))
    )
    return np.asarray(np.log(np.mean(np.exp(log_p[1:] - log_p[0]), axis=1)))
