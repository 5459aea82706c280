"""The question `identify`: elastic constants of a plate from its measured frequencies.

Two functions answer it: `identify`, a point estimate by particle swarms, and `sample`, the posterior by
emcee, on the command line ``identify --backend emcee``.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Final, Literal, get_args

from cpam_bayes.command import PLATES, TIME_LIMIT, Command, option, positive, whole
from cpam_bayes.identification.search import MOST_SWARMS, Residual
from cpam_bayes.inference.ensemble import DEFAULT_SETTINGS
from cpam_bayes.inference.posterior import Likelihood
from cpam_bayes.inference.swarm import SwarmSettings
from cpam_bayes.plate import PlateLike, read_plate
from cpam_bayes.questions.identify import posterior as posterior  # how a posterior is shown
from cpam_bayes.questions.identify.emcee import SampledResult, sample
from cpam_bayes.questions.identify.joint import MAX_SCATTER, JointResult
from cpam_bayes.questions.identify.pso import PointResult, identify
from cpam_bayes.running import SILENT, Watch

__all__ = ["COMMAND", "JointResult", "PointResult", "SampledResult", "answered", "identify", "sample"]

Backend = Literal["pso", "emcee"]

# Options of one back end only.
_OWN: Final[dict[Backend, tuple[str, ...]]] = {
    "pso": ("residuals", "swarms", "particles", "iterations", "scatter"),
    "emcee": ("steps", "store", "likelihood", "noise"),
}
# Noise distribution -> degrees of freedom.
_NOISE: Final = {"gaussian": float("inf"), "student-t": 4.0}


def answered(
    plate: PlateLike, *, seed: int = 0, watch: Watch = SILENT, backend: Backend | None = None, **given: Any
) -> PointResult | SampledResult:
    """The answer of one back end; an option that is None counts as left out.

    backend : if left out, the swarm, or emcee where the list may lack modes
    """
    if backend is None:
        plate = read_plate(plate)
        is_complete = plate.measurement is None or plate.measurement.complete
        backend = "pso" if is_complete else "emcee"
    asked = {name: value for name, value in given.items() if value is not None}
    foreign = [name for name in asked if name not in _OWN[backend]]
    if foreign:
        raise ValueError(f"--{foreign[0]}: not an option of the back end {backend}; leave it out")
    if backend == "pso":
        settings = {name: asked.pop(name) for name in ("particles", "iterations") if name in asked}
        return identify(plate, seed=seed, settings=SwarmSettings(**settings), watch=watch, **asked)
    if "noise" in asked:
        asked["degrees_of_freedom"] = _NOISE[asked.pop("noise")]
    if "steps" in asked:
        steps = asked.pop("steps")
        rounds = min(steps, DEFAULT_SETTINGS.round_steps)
        asked["settings"] = replace(DEFAULT_SETTINGS, most_steps=steps, round_steps=rounds)
    return sample(plate, seed=seed, watch=watch, **asked)


def _answered(
    plate: PlateLike, *more: PlateLike, backend: Backend | None = None, **given: Any
) -> PointResult | JointResult | SampledResult:
    """The answer for one plate, or the joint answer for several, which only the swarm gives."""
    if not more:
        return answered(plate, backend=backend, **given)
    if backend == "emcee":
        raise ValueError(
            f"--backend emcee: received {1 + len(more)} plates, accepted: one; several are identified "
            "together by pso, whose intervals are those of their posterior"
        )
    asked = {name: value for name, value in given.items() if value is not None}
    foreign = [name for name in asked if name in _OWN["emcee"]]
    if foreign:
        raise ValueError(f"--{foreign[0]}: not an option of the back end pso; leave it out")
    settings = {name: asked.pop(name) for name in ("particles", "iterations") if name in asked}
    second, *others = more
    return identify(plate, second, *others, settings=SwarmSettings(**settings), **asked)


COMMAND: Final = Command(
    _answered,
    (
        PLATES,
        option(
            "--backend",
            choices=get_args(Backend),
            help="pso: the paper's particle swarm; emcee: the posterior, sampled starting from that swarm, "
            "`sample` in Python (default: pso, and emcee where modes may be missing)",
        ),
        option(
            "--residuals",
            choices=get_args(Residual),
            help="pso: what the swarm minimises, squares of differences in Hz, eq. (7), of relative ones, or "
            "of whitened ones, whose posterior gives the intervals (default: whitened)",
        ),
        option(
            "--swarms",
            type=whole(1, 1000),
            metavar="N",
            help="pso: swarms at most, until two have found the best optimum, 1 to 1000; 1 is the paper's "
            f"single swarm, not polished (default: {MOST_SWARMS})",
        ),
        option(
            "--scatter",
            type=positive(MAX_SCATTER),
            metavar="S",
            help="of several plates: standard deviation of a constant from plate to plate, relative, "
            f"above 0, at most {MAX_SCATTER:g} (default: 0.02)",
        ),
        option(
            "--particles",
            type=whole(5, 10_000),
            metavar="N",
            help="pso: particles of a swarm, 5 to 10000 (default: 40)",
        ),
        option(
            "--iterations",
            type=whole(1, 100_000),
            metavar="N",
            help="pso: budget of a swarm, 1 to 100000 iterations (default: 400)",
        ),
        option(
            "--steps",
            type=whole(1, 10_000_000),
            metavar="N",
            help="emcee: budget of the chains in steps, used in rounds of 100 (default: 10000)",
        ),
        option(
            "--store",
            metavar="DIR",
            help="emcee: keep finished rounds in DIR; the same command resumes there",
        ),
        option(
            "--likelihood",
            choices=get_args(Likelihood),
            help="emcee: noise in proportion to a frequency, or one standard deviation in Hz for all modes, "
            "which is inferred: eq. (7) (default: relative)",
        ),
        option(
            "--noise",
            choices=tuple(_NOISE),
            help="emcee: gaussian, or student-t with 4 degrees of freedom, which a few bad frequencies do "
            "not sway (default: gaussian)",
        ),
        TIME_LIMIT,
    ),
)
