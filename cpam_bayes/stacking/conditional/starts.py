"""Starts of a sequence: the constants of a library whose frequencies are most like the measured ones."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.stacking.conditional.posterior import ConditionalPosterior

Array = NDArray[Any]

# Numbers in the matrices of sequences that are solved for together.
_TOGETHER = 2048


def scan_library(conditional: ConditionalPosterior, size: int, rng: np.random.Generator) -> Array:
    """Constants drawn from their prior that meet the constraints (9), (size or fewer, n_constants)."""
    n = conditional.template.model.parameters.size
    drawn = conditional.parameters.sample(rng, 8 * size)
    return np.asarray(drawn[np.isfinite(conditional.template.log_prior(drawn))][:size, :n])


def scanned_starts(conditional: ConditionalPosterior, angles_deg: Array, library: Array, n: int) -> Array:
    """The n members of a library that suit the list best with each sequence (m, k), (m, n, n_parameters).

    Stiffnesses that are all multiplied by a^2 multiply all frequencies by a: each member counts with the
    factor that suits the list best, as far as the bounds allow. Where modes cross, optima are many, and
    the nearest member is in the right one more often than a fixed start. An inferred noise starts at the
    misfit.

    library : (p, n_constants).
    """
    each = max(_TOGETHER // len(library), 1)
    parts = [
        _scanned(conditional, angles_deg[i : i + each], library, n) for i in range(0, len(angles_deg), each)
    ]
    return np.concatenate(parts)


def _scanned(conditional: ConditionalPosterior, angles_deg: Array, library: Array, n: int) -> Array:
    m, p = len(angles_deg), len(library)
    parameters = conditional.template.model.parameters
    measured = conditional.template.measurement.frequencies
    at = conditional.at(np.repeat(angles_deg, p, axis=0))
    found = at.predict(np.tile(library, (m, 1)))[:, : len(measured)].reshape(m, p, -1)
    ratio = np.log(measured / found)
    moduli = np.array([name[0] in "EG" for name in parameters.names])
    # the factors that keep every stiffness within its bounds
    low = np.where(moduli, parameters.lower / library, 0.0).max(axis=1)
    high = np.where(moduli, parameters.upper / library, np.inf).min(axis=1)
    factor = np.clip(np.exp(2.0 * ratio.mean(axis=2)), low, high)
    misfit = np.sqrt(np.mean((ratio - 0.5 * np.log(factor)[..., None]) ** 2, axis=2))
    best = np.argsort(misfit, axis=1, kind="stable")[:, :n]
    scale = np.take_along_axis(factor, best, axis=1)[..., None]
    starts = np.where(moduli, scale * library[best], library[best])
    if conditional.template.noise_is_inferred:
        prior = conditional.parameters.parameters[-1].prior
        amplitude = np.clip(np.take_along_axis(misfit, best, axis=1), 2.0 * prior.lower, 0.5 * prior.upper)
        starts = np.concatenate((starts, amplitude[..., None]), axis=2)
    return np.asarray(starts)
