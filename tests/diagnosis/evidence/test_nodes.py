"""Components of a mixture about the optima at held sizes."""

from __future__ import annotations

from typing import Any, cast

import numpy as np

from cpam_bayes.diagnosis.comparison import Comparison
from cpam_bayes.diagnosis.evidence.optima import Nodes
from cpam_bayes.inference.derivatives import Expansion


class Bell:
    """A standard normal density of two scores."""

    def expand(self, z: np.ndarray) -> Expansion:
        return Expansion(-0.5 * np.sum(z**2, axis=1), -z, np.tile(np.eye(2), (len(z), 1, 1)))


def test_sizes_at_which_the_plate_buckles_have_no_component() -> None:
    """Their densities are so low that a sum with the mass of any other node would be lost in rounding."""
    value = np.array([[-1e300, -np.inf], [-20.0, -21.0], [-22.0, -np.inf]])
    nodes = Nodes((0,), np.array([[-2.0], [0.0], [1.0]]), value, np.zeros((3, 2, 1)), np.ones((3, 2, 1, 1)))
    log_mass = np.array([-720.0, -20.5, -22.0])
    z, factor, each = nodes.components(
        cast("Comparison", cast("Any", Bell())), log_mass, np.ones((3, 1)), 1e-4
    )
    np.testing.assert_array_equal(z[:, 0], [0.0, 0.0, 1.0])
    # the two optima of a node divide its mass
    np.testing.assert_allclose(np.logaddexp(each[0], each[1]), -20.5)
    np.testing.assert_allclose(each[2], -22.0)
    assert factor.shape == (3, 2, 2)
