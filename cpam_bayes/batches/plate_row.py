"""What a batch keeps of one plate: constants, their likelihood, the diagnosis; or why there is none."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.batches.limits import MarginalPosterior
from cpam_bayes.diagnosis.cases import hypotheses_of, plate_case
from cpam_bayes.diagnosis.diagnose import diagnose_cases
from cpam_bayes.effects import CATALOGUE
from cpam_bayes.forward_model.labels import labelled_model
from cpam_bayes.identification.identify import PointResult, identify
from cpam_bayes.inference.derivatives import expand_likelihood
from cpam_bayes.inference.posterior import plate_posterior
from cpam_bayes.parameters import TruncatedNormal
from cpam_bayes.plate import Measurement, Specimen

__all__ = ["LocalLikelihood", "PlateDiagnosis", "PlateRow", "RowConstant", "computed_row", "failed_row"]

Array = NDArray[Any]

# Digits of floats survive a round trip through JSON.
_SOLVER_FLOOR = 5e-5


@dataclass(frozen=True, slots=True)
class RowConstant:
    """One constant of a plate, SI.

    value, sd, low, high, verdict : as `identify` gives them by relative residuals; low and high are the 95 %
        interval, nan where none can be given
    posterior : Laplace's approximation of its marginal posterior
    """

    name: str
    value: float
    sd: float
    low: float
    high: float
    verdict: str
    posterior: MarginalPosterior


@dataclass(frozen=True, slots=True)
class LocalLikelihood:
    """The likelihood of a plate's constants about its optimum, sizes integrated over.

    log p(list | c) = gradient . d - 1/2 d . information . d + constant, d = c - at

    at, gradient : (n,) SI; information : (n, n)
    """

    names: tuple[str, ...]
    at: tuple[float, ...]
    gradient: tuple[float, ...]
    information: tuple[tuple[float, ...], ...]


@dataclass(frozen=True, slots=True)
class PlateDiagnosis:
    """The claim about one plate, as of `diagnose`.

    probability_beside : that anything acts beside a claimed cause
    """

    claim: str
    causes: tuple[str, ...]
    probability: float
    probability_none: float
    probability_beside: float = 0.0


@dataclass(frozen=True, slots=True)
class PlateRow:
    """One plate of a batch.

    file : as it was given
    message : why it failed, or the warnings of its identification
    rms : of the relative residuals; noise : relative standard deviation that the intervals assume
    misfit : over the stated noise, as of `PointEstimate`; 1 where that explains it
    """

    file: str
    name: str
    status: Literal["done", "failed"]
    message: str
    material: str = ""
    constants: tuple[RowConstant, ...] = ()
    likelihood: LocalLikelihood | None = None
    diagnosis: PlateDiagnosis | None = None
    rms: float = float("nan")
    noise: float = float("nan")
    search: str = ""
    misfit: float = 1.0

    def constant(self, name: str) -> RowConstant | None:
        """A constant by its name."""
        return next((c for c in self.constants if c.name == name), None)

    def stored(self) -> bytes:
        """The row as a text that `row_of` reads."""
        return json.dumps(asdict(self)).encode()


def row_of(content: bytes) -> PlateRow:
    """The row of a stored text; raises ``ValueError``, ``KeyError`` or ``TypeError`` for others."""
    raw: dict[str, Any] = json.loads(content)
    constants = tuple(
        RowConstant(**{**c, "posterior": MarginalPosterior(**c["posterior"])}) for c in raw["constants"]
    )
    likelihood, diagnosis = raw["likelihood"], raw["diagnosis"]
    return PlateRow(
        **{
            **raw,
            "constants": constants,
            "likelihood": None if likelihood is None else _likelihood(likelihood),
            "diagnosis": None
            if diagnosis is None
            else PlateDiagnosis(**{**diagnosis, "causes": tuple(diagnosis["causes"])}),
        }
    )


def _likelihood(raw: Mapping[str, Any]) -> LocalLikelihood:
    information = tuple(tuple(row) for row in raw["information"])
    return LocalLikelihood(tuple(raw["names"]), tuple(raw["at"]), tuple(raw["gradient"]), information)


def failed_row(file: str, name: str, message: str) -> PlateRow:
    """The row of a plate that has no answer."""
    return PlateRow(file, name, "failed", " ".join(message.split()))


def computed_row(file: str, specimen: Specimen, seed: int, diagnosis: bool) -> PlateRow:
    """The constants of a plate by swarms, Laplace's approximation, and the diagnosis where asked for.

    Raises what `identify` and `diagnose` raise.
    """
    # relative residuals: their optimum is that of the posterior, which the limits are asked of
    point = identify(specimen, seed=seed, residual="relative")
    estimate = point.estimate
    likelihood = local_likelihood(point)
    marginals = _marginals(point, likelihood)
    return PlateRow(
        file=file,
        name=specimen.name,
        status="done",
        message=" ".join(f"{w}." for w in point.warnings),
        material=specimen.material.name or "",
        constants=tuple(
            RowConstant(
                c.name,
                c.value,
                c.sd,
                *((float("nan"),) * 2 if c.interval is None else c.interval),
                c.verdict,
                marginal,
            )
            for c, marginal in zip(estimate.constants, marginals, strict=True)
        ),
        likelihood=likelihood,
        diagnosis=_diagnosed(specimen) if diagnosis else None,
        rms=estimate.rms,
        noise=estimate.noise,
        search=point.status,
        misfit=estimate.misfit,
    )


def local_likelihood(point: PointResult) -> LocalLikelihood:
    """The likelihood about the answer of the swarm, with its noise and with [plate.sd] integrated over.

    An error z of a size, in its standard deviations, shifts the constants that repeat the list by B z: the
    integral over z of a Gaussian likelihood is F - F B (1 + B^T F B)^-1 B^T F, and its gradient alike.
    """
    estimate, specimen = point.estimate, point.specimen
    measurement = specimen.measurement
    assert measurement is not None
    model = labelled_model(estimate.model, measurement, specimen)
    error = np.hypot(estimate.model.full.error, _SOLVER_FLOOR)
    posterior = plate_posterior(model, _with_noise(point, measurement), error)
    at = np.array([c.value for c in estimate.constants])
    expansion = expand_likelihood(posterior, at[None])
    g, f = expansion.gradient[0], expansion.curvature[0]
    known = [e for e in estimate.scale_errors if e.sd is not None]
    if known:
        b = np.array([[e.shift[c.name] * (e.sd or 0.0) * c.value for e in known] for c in estimate.constants])
        back = f @ b @ np.linalg.inv(np.eye(b.shape[1]) + b.T @ f @ b) @ b.T
        g, f = g - back @ g, f - back @ f
        f = 0.5 * (f + f.T)
    names = tuple(c.name for c in estimate.constants)
    return LocalLikelihood(names, tuple(at.tolist()), tuple(g.tolist()), tuple(map(tuple, f.tolist())))


def _with_noise(point: PointResult, measurement: Measurement) -> Measurement:
    """The measurement with the noise that the intervals of the swarm assume, Birge's ratio in it."""
    estimate = point.estimate
    if measurement.frequency_sd is not None:
        return replace(measurement, frequency_sd=estimate.misfit * measurement.frequency_sd)
    level = estimate.noise if np.isfinite(estimate.noise) else estimate.rms
    return replace(measurement, relative_std=float(np.clip(estimate.misfit * level, 1e-6, 1.0)))


def _marginals(point: PointResult, likelihood: LocalLikelihood) -> list[MarginalPosterior]:
    """Laplace's approximation of the marginals, bounded by their priors.

    A constant that the data leave open keeps the width of its prior, as in `gauss_newton_covariance`.
    """
    estimate, unknowns = point.estimate, point.specimen.unknowns
    priors = [unknowns[name].prior for name in likelihood.names]
    curvature = np.diag([prior.sd**-2.0 for prior in priors])
    covariance = np.linalg.inv(np.array(likelihood.information) + curvature)
    pull = np.array(
        [
            (prior.loc - at) / prior.scale**2 if isinstance(prior, TruncatedNormal) else 0.0
            for prior, at in zip(priors, likelihood.at, strict=True)
        ]
    )
    centre = np.array(likelihood.at) + covariance @ (np.array(likelihood.gradient) + pull)
    n = len(estimate.predicted) - len(estimate.constants)
    freedom = float(n) if estimate.noise_is_inferred and n > 0 else float("inf")
    return [
        MarginalPosterior(float(c), float(sd), freedom, prior.lower, prior.upper)
        for c, sd, prior in zip(centre, np.sqrt(np.diagonal(covariance)), priors, strict=True)
    ]


def _diagnosed(specimen: Specimen) -> PlateDiagnosis:
    """The claim, without what `diagnose` adds to it: the gain, detectable sizes, further tests."""
    cases = [plate_case(specimen)]
    found = diagnose_cases(cases, hypotheses=hypotheses_of(cases, CATALOGUE), gain=False, power=False)
    none = found.weighed.by_cause().get("none", 0.0)
    claim = found.claim
    return PlateDiagnosis(
        claim.kind,
        tuple(claim.causes),
        float(claim.probability),
        float(none),
        float(found.probability_beside),
    )
