"""Pairings of an incomplete frequency list with the modes of the model, and their prior probabilities."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.diagnosis.fitting import PlateCase
from cpam_bayes.inference.pairing import PairingPrior, monotone_log_likelihood, most_probable_pairing
from cpam_bayes.plate import Measurement

Array = NDArray[Any]


def is_incomplete(case: PlateCase) -> bool:
    """Whether pairings of a plate's list are summed over."""
    return not case.measurement.complete


def is_open_ended(case: PlateCase) -> bool:
    """Whether the last frequency of an incomplete list is a false peak.

    Only then does the pairing itself not say how many modes below it are missed.
    """
    return is_incomplete(case) and bool(case.modes[-1] < 0)


def pairing_prior(measurement: Measurement) -> PairingPrior:
    """Probabilities of missed modes and of false peaks that the plate file gives."""
    return PairingPrior(measurement.missed_probability, measurement.false_peaks)


def labelled(case: PlateCase) -> Array:
    """Which frequencies keep the mode of their label or of their shape, (n,) bool."""
    if case.by_shape is not None:
        return np.asarray(case.by_shape.modes >= 0)
    return np.array([bool(label) for label in case.measurement.labels])


def with_pairing(case: PlateCase, modes: Array, missed_above: int = 0) -> PlateCase:
    """A plate whose list is paired otherwise.

    The log prior is n_paired log(1 - p) + n_missed log p + n_false log(lambda / f_last), with the modes
    below the highest paired one that the list lacks as missed (``PairingPrior``); a list that is complete
    has no such prior.

    modes : (n,) model mode of every frequency, -1 for a false peak
    missed_above : modes above the highest paired one and below the last frequency, a false peak then
    """
    if case.measurement.complete:
        return replace(case, modes=modes)
    prior, paired = pairing_prior(case.measurement), modes[modes >= 0]
    n_false = len(modes) - len(paired)
    n_missed = int(paired.max(initial=-1)) + 1 - len(paired) + missed_above
    log_prior = len(paired) * np.log1p(-prior.missed)
    with np.errstate(divide="ignore"):
        if n_missed:
            log_prior += n_missed * np.log(prior.missed)
        if n_false:
            log_prior += n_false * (np.log(prior.spurious) - np.log(case.measurement.frequencies[-1]))
    return replace(case, modes=modes, log_pairing=float(log_prior))


def counted(case: PlateCase, predicted: Array) -> PlateCase:
    """The same pairing with the modes that predictions (k,) have below the last frequency as missed."""
    if not is_open_ended(case):
        return case
    first = int(case.modes.max(initial=-1)) + 1
    above = int(np.sum(predicted[first:] <= case.measurement.frequencies[-1]))
    return with_pairing(case, case.modes, above)


def most_probable(case: PlateCase, predicted: Array, sigma: Array) -> Array:
    """The most probable modes (n,) at predictions (k,) with noise (n,) Hz; labelled ones keep theirs."""
    fixed = labelled(case)
    columns = np.setdiff1d(np.arange(len(predicted)), case.modes[fixed])
    f = case.measurement.frequencies
    density = log_density(f[~fixed], predicted[None, columns], sigma[~fixed])[0]
    pairing = most_probable_pairing(
        density, predicted[columns] <= f[-1], f[-1], pairing_prior(case.measurement)
    )
    modes = np.array(case.modes)
    modes[~fixed] = np.where(pairing.mode >= 0, columns[pairing.mode], -1)
    return modes


def log_sum(case: PlateCase, predicted: Array, relative: float) -> Array:
    """Log likelihood of predictions (m, k) summed over all pairings, at a relative noise, (m,)."""
    fixed, f = labelled(case), case.measurement.frequencies
    columns = np.setdiff1d(np.arange(predicted.shape[1]), case.modes[fixed])
    density = log_density(f[~fixed], predicted[:, columns], relative * f[~fixed])
    value = monotone_log_likelihood(
        density, predicted[:, columns] <= f[-1], f[-1], pairing_prior(case.measurement)
    )
    away = (f[fixed] - predicted[:, case.modes[fixed]]) / (relative * f[fixed])
    return np.asarray(value - 0.5 * np.sum(away**2, axis=1))


def log_density(f: Array, predicted: Array, sigma: Array) -> Array:
    """Log density of frequencies (n,) about predictions (m, k), (m, n, k)."""
    away = (f[:, None] - predicted[:, None, :]) / sigma[:, None]
    return np.asarray(-0.5 * away**2 - np.log(sigma)[:, None] - 0.5 * np.log(2 * np.pi))


def neighbours(case: PlateCase) -> list[Array]:
    """Modes (n,) of all pairings one move away.

    A frequency is false or of another mode, or all above it are those of the next modes.
    """
    fixed = labelled(case)
    columns = np.setdiff1d(np.arange(case.models.n_modes), case.modes[fixed])
    place = {int(mode): at for at, mode in enumerate(columns)}
    rank = np.array([place.get(int(mode), -1) for mode in case.modes[~fixed]])
    n, k = len(rank), len(columns)
    moved: list[Array] = []
    for i in range(n):
        below, above = rank[:i].max(initial=-1), min((r for r in rank[i + 1 :] if r >= 0), default=k)
        moved += [_moved(rank, i, r) for r in (-1, *range(int(below) + 1, int(above))) if r != rank[i]]
        if rank[i] < 0:
            continue
        for step in (-1, 1):
            shifted = np.where((np.arange(n) >= i) & (rank >= 0), rank + step, rank)
            if shifted.max() < k and shifted[i] > below:
                moved.append(shifted)
            at = i + step
            if 0 <= at < n and rank[at] < 0:  # the next frequency is the mode, and this one false
                moved.append(_moved(_moved(rank, at, rank[i]), i, -1))
    modes = []
    for r in moved:
        changed = np.array(case.modes)
        changed[~fixed] = np.where(r >= 0, columns[r], -1)
        modes.append(changed)
    return modes


def _moved(rank: Array, i: int, to: int) -> Array:
    moved = rank.copy()
    moved[i] = to
    return moved
