"""Ply angles as fuzzy memberships, section 3, eq. (3) to (5) of the paper.

The memberships X and their velocities V of one particle are the matrices of eq. (3) and (4): a column
for each unknown ply, a row for each angle of the grid (10). They are held here as arrays of shape
``(particles, plies, angles)``, so that a column of the paper is the last axis.

The paper leaves open how a matrix becomes a sequence, where the fuzzy swarm starts and what is done
with a column that has lost all its members. H. Liu, A. Abraham and A. E. Hassanien (Future Generation
Computer Systems 26, 2010, 1336-1343), whose scheduling problem section 3 describes, take the row of
the largest membership and draw an empty column anew; both are done here. The start is drawn uniformly
and at rest, as the constants are.
"""

from __future__ import annotations

import numpy as np

from cpam_bayes.inference.swarm.settings import FloatArray, IndexArray


def decode(memberships: FloatArray) -> IndexArray:
    """Sequences of fuzzy matrices: of each ply the angle of the largest membership.

    memberships : (..., n_plies, n_angles) -> (..., n_plies) grid indices.
    """
    return np.asarray(np.argmax(memberships, axis=-1), dtype=np.int64)


def normalised(memberships: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Memberships made lawful as section 3 says: none negative, those of one ply summing to 1.

    A ply without any positive membership gets uniform random ones, see the module's text.

    memberships : (..., n_plies, n_angles), any real numbers.
    """
    positive = np.maximum(memberships, 0.0)
    total = positive.sum(axis=-1, keepdims=True)
    empty = ~(total[..., 0] > 0.0)
    if empty.any():
        # 1 - [0, 1): never all zero
        positive[empty] = 1.0 - rng.random((int(empty.sum()), memberships.shape[-1]))
        total = positive.sum(axis=-1, keepdims=True)
    return np.asarray(positive / total)
