"""Results from a posterior: converged chains, evidence by importance sampling, draws for arviz."""

from __future__ import annotations

import json
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np

from cpam_bayes import __version__
from cpam_bayes.answer import Notice
from cpam_bayes.fingerprint import fingerprint
from cpam_bayes.forward_model.known_errors import narrowed
from cpam_bayes.inference.ensemble import (
    DEFAULT_SETTINGS,
    Diagnostics,
    EnsembleResult,
    EnsembleSettings,
    problem_hash,
    sample,
    start_positions,
)
from cpam_bayes.inference.importance import Proposal, Rounds, about_optima, importance
from cpam_bayes.inference.laplace import POLISHED, find_optima
from cpam_bayes.inference.posterior import Posterior
from cpam_bayes.inference.student_mixture import RELIABLE_K, Weighted, weighted
from cpam_bayes.inference.swarm import SwarmSettings, minimise
from cpam_bayes.mechanics.problem import Array
from cpam_bayes.plate import Specimen, to_user, unit_of, user_name
from cpam_bayes.running import single_blas_thread
from cpam_bayes.storage import opened_draws

# Rounds of importance sampling for an evidence, and for the chains' jump proposal, which may be rougher.
EVIDENCE: Final = Rounds(log2_points=11, most=12, least=2, enough=4000.0, steady=0.02)
JUMPS: Final = Rounds(log2_points=9, most=12, least=2, enough=1500.0, steady=0.05, good=0.6)
# The basis about a posterior: draws from which it is made, its largest error, the same over the noise, and
# the quantile over draws of that noise.
_NARROWED_SETS, _NARROWED_ERROR, _NARROWED_SHARE, _LEAST_NOISE = 400, 2e-3, 0.05, 0.01
# Fewest effective draws of a reliable evidence; nats within which optima are as high as the best.
_FEWEST_EFFECTIVE, _ALIKE_NATS = 100.0, 3.0
# Draws of the chains, beside their best, from which an evidence starts.
_OF_CHAINS = 24
# Draws of the chains that are reweighted on the whole basis.
_REWEIGHTED = 1000
# Effective fraction of these below which chains on the narrow basis are doubtful.
_EXACT = 0.9


@single_blas_thread
def sample_posterior(
    posterior: Posterior,
    seed: int,
    *,
    settings: EnsembleSettings = DEFAULT_SETTINGS,
    swarm_settings: SwarmSettings | None = None,
) -> EnsembleResult:
    """Chains of a posterior by emcee, started from a swarm that maximises it.

    Raises ``ValueError`` if no particle is in the support of the prior.
    """
    bests, values, _ = swarm_on_posterior(posterior, seed, swarm_settings or SwarmSettings())
    return sample_from(posterior, bests, values, seed, settings=settings)[0]


def sample_from(
    posterior: Posterior,
    bests: Array,
    values: Array,
    seed: int,
    *,
    settings: EnsembleSettings = DEFAULT_SETTINGS,
    store: Path | None = None,
    progress: Callable[[Diagnostics], None] = lambda diagnostics: None,
) -> tuple[EnsembleResult, Posterior]:
    """Chains of a posterior by emcee, started from the personal bests of a swarm, and the density sampled.

    This is the posterior on a narrow basis made for its own region, see ``reweighted``.

    bests : (m, n_plate) parameters of the plate, without the noise.
    values : (m,) their misfits.

    Raises ``StoreError`` if the store cannot be used.
    """
    rng = np.random.default_rng([seed, 1])
    n_walkers = settings.ensembles * settings.walkers
    walkers = start_positions(posterior, bests, values, n_walkers, rng)
    start = walkers.reshape(settings.ensembles, settings.walkers, -1)
    best = walkers[np.argmax(posterior.log_prob(walkers))]
    proposal = sampled_about(posterior, best[None], JUMPS)[0]
    fast = _narrowed(posterior, proposal.draw(_NARROWED_SETS, rng))
    return sample(fast, start, seed, settings, proposal=proposal, store=store, progress=progress), fast


def _narrowed(posterior: Posterior, x: Array) -> Posterior:
    """A posterior on a basis for the region of its draws x (m, n), accurate to a small part of the noise.

    The posterior itself where that is no improvement.
    """
    x = x[np.isfinite(posterior.log_prior(x))]
    f = posterior.predict(x)
    i = np.arange(min(posterior.measurement.size, f.shape[1]))
    noise = (posterior.noise(x, f)[:, i, i] / f[:, i]).min(axis=1)
    tolerance = min(_NARROWED_ERROR, _NARROWED_SHARE * float(np.quantile(noise, _LEAST_NOISE)))
    model = narrowed(posterior.model, x[:, : posterior.model.parameters.size], tolerance)
    return posterior if model is posterior.model else replace(posterior, model=model)


def swarm_on_posterior(posterior: Posterior, seed: int, settings: SwarmSettings) -> tuple[Array, Array, int]:
    """Personal bests of the plate's parameters, their values and the solves of a swarm on -log p."""
    rng = np.random.default_rng(seed)
    n = posterior.model.parameters.size
    swarm = minimise(
        lambda x: -posterior.log_prob(x),
        posterior.parameters.lower,
        posterior.parameters.upper,
        posterior.parameters.sample(rng, settings.particles),
        settings,
        rng,
        feasible=lambda x: np.isfinite(posterior.log_prior(x)),
    )
    return swarm.personal_bests[:, :n], swarm.personal_values, swarm.evaluations


@dataclass(frozen=True, slots=True)
class Evidence:
    """The integral of likelihood times prior density, and the quality of its estimate.

    standard_error : of log_evidence, from the spread of the weights, those of a narrow basis included.
    effective_size : (sum w)^2 / sum w^2.
    k_hat : Pareto shape of the largest weights.
    status : reliable where k_hat is below 0.7, the effective size above 100 and the optima few; otherwise
    neither value nor error is to be relied on.
    solves : forward solves, without those of the search for optima.
    exact_fraction : effective fraction of draws of chains on a narrow basis, reweighted on the whole one.

    The prior is the product of the parameters' densities, zero where the constraints (9) are violated; it
    is not renormalised for these.
    """

    log_evidence: float
    standard_error: float
    effective_size: float
    k_hat: float
    status: Literal["reliable", "unreliable"]
    solves: int
    exact_fraction: float = 1.0


def reweighted(
    evidence: Evidence, posterior: Posterior, fast: Posterior, chains: EnsembleResult, seed: int
) -> Evidence:
    """Evidence on the whole basis: that on a narrow one plus log E[p / p_fast] over draws of chains."""
    if fast is posterior:
        return evidence
    rows = np.random.default_rng([seed, 6]).integers(len(chains.draws), size=_REWEIGHTED)
    x = chains.draws[rows]
    moments = weighted(x[None], (posterior.log_likelihood(x) - fast.log_likelihood(x))[None])
    return replace(
        evidence,
        log_evidence=evidence.log_evidence + float(moments.log_evidence[0]),
        standard_error=float(np.hypot(evidence.standard_error, moments.standard_error[0])),
        exact_fraction=float(moments.effective_size[0]) / len(x),
    )


def basis_notices(evidence: Evidence) -> tuple[Notice, ...]:
    """Notice where chains on a narrow basis differ from those on the whole one."""
    if evidence.exact_fraction >= _EXACT:
        return ()
    return (Notice("narrow_basis", facts={"fraction": evidence.exact_fraction}),)


def evidence_of(posterior: Posterior, result: EnsembleResult) -> Evidence:
    """Evidence of a posterior with known chains.

    Optima are also sought from draws of the prior, so that one that the chains missed counts.
    """
    some = np.linspace(0, len(result.draws) - 1, _OF_CHAINS).astype(int)
    best = int(np.argmax(result.log_prob))
    return importance_evidence(posterior, result.draws[[best, *some]])


@single_blas_thread
def importance_evidence(posterior: Posterior, known: Array, rounds: Rounds = EVIDENCE) -> Evidence:
    """Evidence of a posterior by importance sampling about its optima, see ``importance``.

    Z = E_q[p / q], q the blend of Student-t mixtures over normal scores. It is not reliable where so many
    optima are as high as the best that the search is likely to miss others. Raises ``ValueError`` where
    nothing lies in the support of the prior.

    known : (m, n) starts of the search for optima, besides draws from the prior; may be empty.
    """
    proposal, found, alike = sampled_about(posterior, known, rounds)
    k_hat, effective = float(found.k_hat[0]), float(found.effective_size[0])
    is_reliable = k_hat < RELIABLE_K and effective > _FEWEST_EFFECTIVE and alike < POLISHED.rounds[-1][0]
    return Evidence(
        log_evidence=float(found.log_evidence[0]),
        standard_error=float(found.standard_error[0]),
        effective_size=effective,
        k_hat=k_hat,
        status="reliable" if is_reliable else "unreliable",
        solves=proposal.solves,
    )


def sampled_about(posterior: Posterior, known: Array, rounds: Rounds) -> tuple[Proposal, Weighted, int]:
    """Proposal that covers a posterior, its weighted points over scores, and number of highest optima.

    known : (m, n) as of ``importance_evidence``
    """
    scores = posterior.scores
    optima = find_optima(posterior, scores.to_z(known), settings=POLISHED)
    found, mixture = importance(
        lambda z: posterior.log_density(z[0])[None], about_optima(optima), rounds, posterior.expand
    )
    alike = int(np.sum(optima.value > optima.value[0] - _ALIKE_NATS))
    return Proposal(scores, mixture.alone(), found.points.shape[1]), found, alike


# Name of the attribute.
_COMMAND: Final = "command"
_LIBRARIES: Final = ("numpy", "scipy", "emcee", "arviz_base")


def command_of_draws(file: Path) -> str | None:
    """The command whose draws a file holds, None for any other file."""
    try:
        found = opened_draws(file).attrs.get(_COMMAND)
    except (OSError, ValueError):  # not NetCDF
        return None
    return None if found is None else str(found)


def by_user_name(names: tuple[str, ...], draws: np.typing.NDArray[Any]) -> dict[str, Any]:
    """Draws (chains, draws, n) by the names of the plate file, in its units."""
    return {user_name(name): draws[..., i] * to_user(name, 1.0) for i, name in enumerate(names)}


def hashed(posterior: Posterior) -> dict[str, str]:
    """Attribute with the hash of the problem of the draws."""
    centre = np.array([[p.prior.mean for p in posterior.parameters.parameters]])
    return {"problem_hash": problem_hash(posterior, centre)}


def described(specimen: Specimen, noise: float | None) -> tuple[dict[str, Any], dict[str, float]]:
    """Description of the plate for a file of draws: attributes, and its group constant_data.

    noise : repeatability of a frequency where it is no parameter and the plate file leaves it out
    """
    plate, material, measurement = specimen.plate, specimen.material, specimen.measurement
    assert measurement is not None
    held = {user_name(n): to_user(n, v) for n, v in material.constants.items() if n not in specimen.unknowns}
    attributes: dict[str, Any] = {
        "specimen": specimen.specimen,
        "symmetry": material.symmetry,
        "held_constants": json.dumps(held, sort_keys=True),
        "layup": plate.layup.text,
        "edges": plate.edges,
    }
    repeatability = noise if measurement.relative_std is None else measurement.relative_std
    if measurement.frequency_sd is not None:
        repeatability = float(np.mean(measurement.frequency_sd / measurement.frequencies))
    if repeatability is not None:
        attributes["repeatability"] = repeatability
    sizes = {user_name(n): to_user(n, getattr(plate, n)) for n in ("length", "width", "thickness", "density")}
    return attributes, sizes


def arviz_data(
    command: str,
    specimen: Specimen,
    seed: int,
    names: Sequence[str],
    attributes: Mapping[str, Any],
    groups: Mapping[str, Mapping[str, Any]],
    dims: Mapping[str, list[str]],
    coords: Mapping[str, Any],
) -> Any:
    """The groups as an ``xarray.DataTree`` in the conventions of arviz 1.

    command : whose draws they are, see `command_of_draws`.
    names : of the parameters that were drawn.
    attributes : further ones beside command, versions, plate and seed.
    groups, dims, coords : as of ``arviz_base.from_dict``.
    """
    import arviz_base  # heavy

    attrs = {
        _COMMAND: command,
        "cpam_bayes_version": __version__,
        "cpam_bayes_fingerprint": fingerprint(__name__),
        **{f"{library}_version": version(library) for library in _LIBRARIES},
        "plate": specimen.name,
        "source": specimen.source,
        "seed": seed,
        **attributes,
    }
    with warnings.catch_warnings():  # many walkers with few thinned draws look like a slip
        warnings.simplefilter("ignore", UserWarning)
        data = arviz_base.from_dict(groups, dims=dims, coords=coords, attrs={"/": attrs})
    for name, group in data.children.items():
        group.attrs.pop("created_at", None)
        if name in ("posterior", "prior"):
            for constant in names:
                group[user_name(constant)].attrs["unit"] = unit_of(constant)
    return data
