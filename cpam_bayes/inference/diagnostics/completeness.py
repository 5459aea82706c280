"""Whether a list that is given as complete seems to lack a mode or to hold a false peak."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.forward_model.labels import LabelledModel, list_order
from cpam_bayes.forward_model.model import Prediction, reference_vector
from cpam_bayes.forward_model.reduced import ReducedModel
from cpam_bayes.inference.derivatives import Expansion, coordinates, expand_u
from cpam_bayes.inference.laplace import laplace_log_evidence
from cpam_bayes.inference.optimise import maximise
from cpam_bayes.inference.posterior import ForwardModel, Posterior
from cpam_bayes.mechanics.shapes import Mode
from cpam_bayes.parameters import ParameterSet
from cpam_bayes.plate import Specimen

Array = NDArray[Any]

# Log odds from which another pairing is far more probable.
_DOUBTFUL_LOG_ODDS = float(np.log(100.0))
# Draws from the prior, and those of them from which an optimum is sought for each pairing.
_DRAWS, _STARTS = 300, 3
_MAX_STEPS = 25


@dataclass(frozen=True, slots=True)
class AlternativePairing:
    """A pairing with one transcription error, far more probable than one to one in a complete list.

    missed : number, from 0, of the model's mode that the list seems to lack, or ``None``.
    spurious : number of the frequency that seems to be no mode, or ``None``.
    log_odds : against one to one.
    x : (n,) parameters where it fits best.
    """

    missed: int | None
    spurious: int | None
    log_odds: float
    x: Array


@dataclass(frozen=True, slots=True)
class TranscriptionError:
    """The transcription error that a complete list seems to have, in terms of the plate.

    missed : the mode that a list seems to lack, where the other modes fit best.
    spurious : the frequency that seems to be no mode, Hz.
    log_odds : against one to one.
    """

    missed: Mode | None
    spurious: float | None
    log_odds: float


def transcription_error(
    specimen: Specimen, posterior: Posterior, model: ReducedModel | LabelledModel, best: Array
) -> TranscriptionError | None:
    """The transcription error that a specimen's list seems to have, ``None`` where it seems to have none.

    best : (n,) optimum of the posterior. Lists that may lack modes are not checked.
    """
    if not posterior.measurement.complete:
        return None
    alternative = alternative_pairing(posterior, best, reference_vector(specimen, model.parameters)[None])
    if alternative is None:
        return None
    if alternative.spurious is not None:
        return TranscriptionError(
            None, float(posterior.measurement.frequencies[alternative.spurious]), alternative.log_odds
        )
    assert alternative.missed is not None
    x = alternative.x[: model.parameters.size]
    modes = model.full.modes(x)
    return TranscriptionError(modes[list_order(model, x)[alternative.missed]], None, alternative.log_odds)


@dataclass(frozen=True, slots=True)
class _Pairing:
    """A one to one pairing of some frequencies with some modes, and the log of its price."""

    rows: Array
    columns: Array
    price: float
    missed: int | None = None
    spurious: int | None = None


@dataclass(frozen=True, slots=True)
class _Places:
    """Parameters of the plate (m, n_plate) to start from; the first ``always`` are for every pairing."""

    x: Array
    always: int


@dataclass(frozen=True, slots=True)
class _Selected:
    """Some modes of a model."""

    model: ForwardModel
    columns: Array

    @property
    def parameters(self) -> ParameterSet:
        return self.model.parameters

    def predict(self, x: Array, *, jacobian: bool = False) -> Prediction:
        prediction = self.model.predict(x, jacobian=jacobian)
        slope = None if prediction.jacobian is None else prediction.jacobian[:, self.columns]
        return Prediction(prediction.frequencies[:, self.columns], slope)

    def admissible(self, x: Array) -> Array:
        return self.model.admissible(x)


def alternative_pairing(posterior: Posterior, best: Array, others: Array) -> AlternativePairing | None:
    """The most probable single transcription error in a complete list, if it is far more probable than none.

    Evidences by Laplace's method of the list paired one to one, with one mode of the model left out,
    or with one frequency left out, at the prices of ``posterior.pairing``. More than 100 times as
    probable counts as far. Labelled frequencies keep their modes. A list that ends too early cannot
    be distinguished from a complete one.

    best : (n,) optimum of the posterior.
    others : (m, n_plate) further parameters to start from. The model must predict a mode more than there are
    frequencies.
    """
    n_plate = posterior.model.parameters.size
    draws = posterior.model.parameters.sample(np.random.default_rng(0), _DRAWS)
    draws = draws[posterior.model.admissible(draws)]
    places = _Places(np.concatenate((best[None, :n_plate], others, draws)), 1 + len(others))
    predicted = posterior.predict(places.x)
    none, *alternatives = _pairings(posterior, predicted.shape[1])
    reference = _evidence(posterior, none, places, predicted)[0]
    candidates = [(*_evidence(posterior, pairing, places, predicted), pairing) for pairing in alternatives]
    if not candidates:
        return None
    log_evidence, x, pairing = max(candidates, key=lambda f: f[0])
    log_odds = log_evidence - reference
    return (
        AlternativePairing(pairing.missed, pairing.spurious, log_odds, x)
        if log_odds > _DOUBTFUL_LOG_ODDS
        else None
    )


def _pairings(posterior: Posterior, n_modes: int) -> Iterator[_Pairing]:
    """The pairing without an error, then every pairing with one."""
    n, prior = posterior.measurement.size, posterior.pairing
    rows = np.arange(n)
    paired = float(np.log1p(-prior.missed))
    yield _Pairing(rows, rows, n * paired)
    free = np.flatnonzero(~posterior.labelled)
    places = np.setdiff1d(np.arange(n_modes), np.flatnonzero(posterior.labelled))
    if len(places) > len(free):
        for k in range(len(free)):
            columns = rows.copy()
            columns[free] = np.delete(places, k)[: len(free)]
            price = n * paired + float(np.log(prior.missed))
            yield _Pairing(rows, columns, price, missed=int(places[k]))
    if n == 1 or prior.spurious == 0.0:
        return
    for k in range(len(free)):
        columns = rows.copy()
        columns[np.delete(free, k)] = places[: len(free) - 1]
        kept = np.delete(rows, free[k])
        price = (n - 1) * paired + float(np.log(prior.spurious / posterior.span))
        yield _Pairing(kept, columns[kept], price, spurious=int(free[k]))


def _evidence(
    posterior: Posterior, pairing: _Pairing, places: _Places, predicted: Array
) -> tuple[float, Array]:
    """Log evidence of a pairing with its price, and its optimum (n,)."""
    paired = _paired(posterior, pairing)
    residuals = predicted[:, pairing.columns] - paired.measurement.frequencies
    misfit = np.sum((residuals / paired.measurement.frequencies) ** 2, axis=1)
    nearest = np.argsort(misfit, kind="stable")[:_STARTS]
    chosen = np.union1d(np.arange(places.always), nearest)
    starts = places.x[chosen]
    if paired.noise_is_inferred:
        noise = [paired.noise_model.suggested(residuals[i]) for i in chosen]
        starts = np.column_stack((starts, noise))
    axes = coordinates(paired)

    def target(u: Array, rows: Array) -> Expansion:
        return expand_u(paired, axes, u)

    u = axes.to_u(np.clip(starts, axes.inner, axes.outer))
    maxima = maximise(target, u, axes.lower, axes.upper, most_steps=_MAX_STEPS)
    inside = np.isfinite(maxima.expansion.value)
    if not inside.any():
        return -np.inf, starts[0]
    e, u = maxima.expansion, maxima.u[inside]
    log_evidence = laplace_log_evidence(e.value[inside], e.gradient[inside], e.curvature[inside], u, axes)
    top = int(np.argmax(log_evidence))
    return float(log_evidence[top]) + pairing.price, axes.to_x(u[top])


def _paired(posterior: Posterior, pairing: _Pairing) -> Posterior:
    """The posterior given that the rows of the list are these columns of the model, in order."""
    full_list, noise = posterior.measurement, posterior.noise_model
    sd = None if full_list.frequency_sd is None else full_list.frequency_sd[pairing.rows]
    measurement = replace(
        full_list,
        frequencies=full_list.frequencies[pairing.rows],
        frequency_sd=sd,
        labels=("",) * len(pairing.rows),
        shapes=None,
    )
    return replace(
        posterior,
        model=_Selected(posterior.model, pairing.columns),
        measurement=measurement,
        noise_model=replace(
            noise, scale=noise.scale[pairing.rows], solver_error=noise.solver_error[pairing.columns]
        ),
        labelled=np.zeros(len(pairing.rows), dtype=bool),
        alternatives=(),
    )
