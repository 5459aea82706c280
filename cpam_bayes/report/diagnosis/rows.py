"""What documents, screens and figures of a diagnosis take from it, in the units of the plate file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.diagnosis.diagnose import Cause, Diagnosis
from cpam_bayes.diagnosis.evidence.weighing import Tested
from cpam_bayes.diagnosis.extension import Resampled
from cpam_bayes.diagnosis.fit import Fit
from cpam_bayes.diagnosis.hypotheses import NONE, OTHER, causes_in
from cpam_bayes.effects import CATALOGUE, scale_of
from cpam_bayes.forward_model.model import reference_constants
from cpam_bayes.identification.verdicts import Verdict, verdict_of
from cpam_bayes.plate import to_user, user_name

__all__ = [
    "ConstantRow",
    "DetectableRow",
    "absorbed_biases",
    "averaged_rows",
    "catalogue_sd",
    "constant_rows",
    "detectable_rows",
    "hidden_causes",
    "is_pair",
    "leading",
    "noise_of",
    "nuisance_of",
    "plate_constants",
    "sampled_rows",
    "shows_constants",
    "shows_detectable",
    "shows_signatures",
    "tested_causes",
    "titles_of",
    "with_signatures",
]

Array = NDArray[Any]

# A cause of which less than this share of the signature is left by the constants is called hidden.
_HIDDEN = 0.3


@dataclass(frozen=True, slots=True)
class ConstantRow:
    """An elastic constant in a fit, in the unit of the plate file; contraction : 1 - (sd / prior sd)^2."""

    name: str
    mean: float
    sd: float
    q025: float
    q975: float
    contraction: float
    verdict: Verdict
    reference: float


@dataclass(frozen=True, slots=True)
class DetectableRow:
    """What the lists would have shown of one cause.

    title : the cause in words
    smallest : size in ``unit``, ``None`` where none would have been claimed
    in_sd : the same in standard deviations of the catalogue
    probability : of a claim at that size, or at the best one; ``None`` for a cause without a size
    """

    cause: str
    title: str
    smallest: float | None
    unit: str | None
    in_sd: float | None
    probability: float | None


def detectable_rows(d: Diagnosis) -> tuple[DetectableRow, ...]:
    """Of all causes that were tested, the sizes in the units of a workshop."""
    titles = titles_of(d)
    rows = []
    for entry in d.detectable:
        p, smallest, in_sd, unit = entry.parameter, None, None, None
        if p is not None:
            unit, factor = p.display
            if entry.smallest is not None:
                smallest, in_sd = factor * entry.smallest, entry.smallest / scale_of(p)
        title = titles.get(entry.cause, entry.cause)
        rows.append(DetectableRow(entry.cause, title, smallest, unit, in_sd, entry.probability_of_claim))
    return tuple(rows)


def titles_of(d: Diagnosis) -> dict[str, str]:
    """Name of a single cause -> the cause in words, of the catalogue and of what was tested."""
    tested = (effect for cause in d.causes for effect in cause.hypothesis.records)
    return {effect.name: effect.title for effect in (*CATALOGUE, *tested)}


def tested_causes(d: Diagnosis) -> tuple[str, ...]:
    """Single causes that were tested, the most probable first."""
    return tuple(c.name for c in d.causes if c.name not in (NONE, OTHER) and not is_pair(c))


def is_pair(cause: Cause | str) -> bool:
    """Whether a cause is two at once."""
    return len(causes_in(cause if isinstance(cause, str) else cause.name)) > 1


def constant_rows(d: Diagnosis, fit: Fit) -> tuple[ConstantRow, ...]:
    """The constants that all plates share."""
    constants = {name: v for name, v in fit.constants.items() if name in _unknowns(d)}
    explained = d.plain_explained if fit is d.baseline else d.explained
    return tuple(_row(d, name, *values, explained=explained) for name, values in constants.items())


def averaged_rows(d: Diagnosis) -> tuple[ConstantRow, ...]:
    """The constants that all plates share, averaged over all hypotheses by their probability."""
    constants = {name: v for name, v in d.averaged.items() if name in _unknowns(d)}
    return tuple(_row(d, name, *values, explained=d.explained) for name, values in constants.items())


def sampled_rows(d: Diagnosis, resampled: Resampled) -> tuple[ConstantRow, ...]:
    """The constants that all plates share, of the extended model by emcee."""
    constants = {name: v for name, v in resampled.constants.items() if name in _unknowns(d)}
    return tuple(_row(d, name, *values, explained=d.explained) for name, values in constants.items())


def plate_constants(d: Diagnosis, fit: Fit, i: int) -> tuple[ConstantRow, ...]:
    """The constants of one plate, with its own deviations from the shared ones."""
    case, names = d.cases[i], list(fit.constants)
    explained = d.plain_explained if fit is d.baseline else d.explained
    rows = []
    for name in case.models.specimen.unknowns.names:
        if name not in names:
            continue
        draws = fit.draws[:, names.index(name)]
        scatter = f"scatter of {name}, {case.models.specimen.specimen}"
        if scatter in names:
            draws = draws * (1.0 + fit.draws[:, names.index(scatter)])
        low, high = np.quantile(draws, (0.025, 0.975))
        values = (float(v) for v in (draws.mean(), draws.std(), low, high))
        rows.append(_row(d, name, *values, explained=explained))
    return tuple(rows)


def nuisance_of(d: Diagnosis, fit: Fit) -> dict[str, tuple[float, float]]:
    """Sizes and deviations from plate to plate, mean and sd: sizes in the plate file's unit and name."""
    nuisance = {}
    for name, (mean, sd, _, _) in fit.constants.items():
        if name in _unknowns(d):
            continue
        if name.startswith("scatter of "):
            nuisance[name] = (mean, sd)
            continue
        base, _, of = name.partition(" of ")
        shown = user_name(base) + (f" of {of}" if of else "")
        nuisance[shown] = (to_user(base, mean), to_user(base, sd))
    return nuisance


def noise_of(members: Sequence[tuple[Tested, float]]) -> tuple[float, float] | None:
    """Mean and sd of the inferred noise over hypotheses and lists, relative; ``None`` where given."""
    mean = square = 0.0
    for t, weight in members:
        columns = [c for c in t.marginal.comparison.amplitudes if c >= 0]
        if not columns:
            return None
        level, sd = (v[columns] for v in t.marginal.moments())
        mean += weight * float(np.mean(level))
        square += weight * float(np.mean(level**2 + sd**2))
    return mean, float(np.sqrt(max(square - mean**2, 0.0)))


def hidden_causes(d: Diagnosis) -> tuple[Cause, ...]:
    """Single causes of which the constants leave little to be seen, the best hidden first."""
    hidden = [c for c in d.causes if c.visible < _HIDDEN and c.parameters and not is_pair(c)]
    return tuple(sorted(hidden, key=lambda cause: cause.visible))


def catalogue_sd(cause: Cause) -> float:
    """One standard deviation of the catalogue of a cause's first parameter, in the unit it is shown in."""
    parameter = cause.hypothesis.parameters[0]
    return float(f"{scale_of(parameter) * parameter.display[1]:.6g}")


def absorbed_biases(d: Diagnosis, cause: Cause) -> tuple[float, str, dict[str, float]]:
    """What a cause that is not modelled does to the constants, to first order.

    Size of the effect and its unit as shown, and by constant its change in % per one of that unit.
    """
    parameter, *_ = cause.hypothesis.parameters
    mean, sd, _ = cause.parameters[parameter.name]
    shown, factor = parameter.display
    # the size that the signature was taken at
    size = float(np.hypot(mean, sd)) * (-1.0 if mean < 0.0 else 1.0) * factor
    names = [n for n in cause.bias if n in _unknowns(d)]
    if size == 0.0:
        return 0.0, shown, {}
    return size, shown, {user_name(n): 100.0 * cause.bias[n] / size for n in names}


def with_signatures(d: Diagnosis) -> list[str]:
    """Single causes that leave something to be seen, the most probable first."""
    return [c.name for c in d.causes if c.name in d.signatures and not is_pair(c) and not c.absorbed]


def shows_signatures(d: Diagnosis) -> bool:
    """Whether there are signatures to be compared."""
    return len(with_signatures(d)) > 1


def shows_detectable(d: Diagnosis) -> bool:
    """Whether some cause has a size that the lists would have shown."""
    return any(row.in_sd is not None for row in detectable_rows(d))


def shows_constants(d: Diagnosis) -> bool:
    """Whether there are constants to be drawn."""
    return bool(constant_rows(d, d.baseline))


def leading(d: Diagnosis, least: float, most: int) -> tuple[Cause, ...]:
    """The causes to show: the most probable, and none and other wherever they stand."""
    shown = []
    for rank, cause in enumerate(d.causes):
        if cause.name in (NONE, OTHER) or (rank < most and (cause.probability >= least or rank < 6)):
            shown.append(cause)
    return tuple(shown)


def _unknowns(d: Diagnosis) -> Mapping[str, None]:
    return dict.fromkeys(name for case in d.cases for name in case.models.specimen.unknowns.names)


def _row(
    d: Diagnosis, name: str, mean: float, sd: float, low: float, high: float, *, explained: bool
) -> ConstantRow:
    case = next(c for c in d.cases if name in c.models.specimen.unknowns.names)
    prior = case.models.parameters[name].prior
    reference = reference_constants(case.models.specimen).get(name, float("nan"))
    return ConstantRow(
        name=user_name(name),
        mean=to_user(name, mean),
        sd=to_user(name, sd),
        q025=to_user(name, low),
        q975=to_user(name, high),
        contraction=1.0 - (sd / prior.sd) ** 2,
        verdict=verdict_of(sd, prior.sd, explained=explained),
        reference=to_user(name, float(reference)),
    )
