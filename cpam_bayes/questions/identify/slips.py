"""Slips of a plate file that explain a gross misfit: hypotheses with priors in the density of `diagnose`.

Slips of the plate, each the plain model of another plate: sides exchanged, layup turned by 90 degrees,
neighbouring edges held, clamps and simple supports exchanged, a free plate clamped at an edge, a held plate
free. Slips of the list: the list errors of the catalogue, and a misplaced decimal point. They are weighed
against no slip, and against no slip with an unexplained residual, and claimed by the rules for causes.

Bounds and priors that the frequencies contradict are slips too, whatever the misfit.
"""

from __future__ import annotations

import json
import math
import re
import tomllib
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final, Literal, NamedTuple, TypeAlias

import numpy as np
from scipy.special import logsumexp

from cpam_bayes.answer import Constant, Notice, Verdict
from cpam_bayes.diagnosis.cases import plate_case
from cpam_bayes.diagnosis.comparison import SCATTER
from cpam_bayes.diagnosis.evidence.marginal import Marginal
from cpam_bayes.diagnosis.evidence.scan import (
    Scan,
    Trial,
    is_repairing,
    marginal_of,
    misfit_probability,
)
from cpam_bayes.diagnosis.hypotheses import (
    CLAIM_RULES,
    NONE,
    OTHER,
    P_NONE,
    P_SINGLE,
    Hypothesis,
    claim_of,
    prior_by_cause,
    single_hypotheses,
)
from cpam_bayes.effects import CATALOGUE, ListChange
from cpam_bayes.errors import LowFrequencyError, PlateFileError
from cpam_bayes.forward_model.model import (
    constant_parameters,
    model_on_basis,
    plate_problem,
    reference_vector,
)
from cpam_bayes.forward_model.preconditions import require_reachable
from cpam_bayes.identification.point import verdict_of
from cpam_bayes.identification.search import required
from cpam_bayes.mechanics.modes import RigidBodyError
from cpam_bayes.mechanics.ritz import RitzSettings, ritz_space
from cpam_bayes.plate import Material, Plate, Specimen, to_user
from cpam_bayes.plate.edges import ALL_FREE, EDGES
from cpam_bayes.plate.layup import from_angles
from cpam_bayes.plate.text import KeyPath, decode, line_numbers
from cpam_bayes.running import is_time_up, single_blas_thread

SlipKind: TypeAlias = Literal[
    "sides", "layup", "edges", "supports", "clamped", "free", "missed", "false", "misread", "decimal"
]

GROSS: Final = 0.005
"""Relative misfit above which slips are tried."""
_DECIMAL: Final = "decimal"
# Causes in the list: missed or false modes, a misreading, a decimal point.
_OF_LIST: Final = 3
# At most this many slips are named: three may have the same spectrum.
_MOST: Final = 3
# Coarse space on which other plates are tried, and the relative misfit up to which one gets a model.
_COARSE: Final = RitzSettings(10, 10, coupled=True)
_IN_SIGHT: Final = 0.03
# Factors of a misplaced decimal point.
_FACTORS: Final = (10.0, 100.0, 1000.0)
_OTHERWISE_HELD: Final = str.maketrans("CS", "SC")
# A key with its value, up to a comment.
_VALUE: Final = re.compile(r"""[^=\n]*=\s*(\[(?:[^\]#]|#[^\n]*)*\]|"[^"\n]*"|'[^'\n]*'|[^#\s]+)""")
_LISTED, _COMPLETE = ("measurement", "frequencies_hz"), ("measurement", "complete")
# Keys that refer to rows of the list by number.
_NUMBERED: Final = (("measurement", "left_out"), ("measurement", "by_hand"))


@dataclass(frozen=True, slots=True, eq=False)
class Slip:
    """One slip, and the plate without it.

    number : of the missed mode or the wrong frequency, from 1; 0 for a slip of the plate
    frequency : Hz, as listed; for a decimal point the corrected one
    corrected : the plate without the slip
    edits : (table, key) -> value of the corrected plate file
    rms : relative, of the corrected fit
    probability : among all slips, no slip, and no slip with an unexplained residual
    """

    kind: SlipKind
    number: int
    frequency: float
    corrected: Specimen
    edits: Mapping[KeyPath, Any]
    rms: float = 0.0
    probability: float = 0.0


class _Weighed(NamedTuple):
    """A hypothesis with its evidence: a slip, no slip, or an unexplained residual; variants share a name.

    slip : None for the two without a slip
    """

    name: str
    slip: Slip | None
    prior: float
    marginal: Marginal

    @property
    def log_weight(self) -> float:
        return float(np.log(self.prior) + self.marginal.log_evidence)

    @property
    def named(self) -> Slip | None:
        """The slip with the rms misfit that it leaves."""
        comparison, z = self.marginal.comparison, self.marginal.z[:1]
        left = comparison.residuals(comparison.predict(comparison.scores.to_x(z))[0])
        relative = (left - comparison.common_part(z)) / comparison.listed.frequencies
        return self.slip and replace(self.slip, rms=float(np.sqrt(np.mean(relative**2))))


def with_slips(
    excess: tuple[Notice, ...],
    specimen: Specimen,
    rms: float,
    announce: Callable[[str], None],
    known: tuple[Slip, ...],
) -> tuple[tuple[Notice, ...], tuple[Slip, ...]]:
    """Notices of a misfit, amended by the slips that explain it, and these slips.

    rms : relative, of the fit; slips are tried above `GROSS`. announce : called before they are tried
    known : slips from `slips_where_unreachable`
    """
    if not excess or rms <= GROSS or (not known and is_time_up()):
        return excess, ()
    if not known:
        announce(f"the misfit of {specimen.name} is gross: trying slips of its file")
    slips = known or explaining_slips(specimen)
    said = tuple((s.kind, s.number, s.frequency, s.corrected.plate.edges) for s in slips)
    facts = {"slips": said, "fit": max((s.rms for s in slips), default=0.0)}
    return tuple(replace(notice, facts={**notice.facts, **facts}) for notice in excess), slips


def slips_where_unreachable(specimen: Specimen) -> tuple[Slip, ...]:
    """Slips that explain a first frequency below the reach of the plate; empty if it is reachable.

    Raises as `require_reachable` does where no slip explains them.
    """
    try:
        require_reachable(specimen)
    except LowFrequencyError:
        slips = explaining_slips(specimen)
        if not slips:
            raise
        return slips
    return ()


def slip_records(slips: Iterable[Slip]) -> list[dict[str, Any]]:
    """Slips as records of the JSON document."""
    return [
        {
            "slip": s.kind,
            "number": s.number,
            "frequency_hz": s.frequency,
            "rms_percent": 100.0 * s.rms,
            "probability": s.probability,
        }
        for s in slips
    ]


@single_blas_thread
def explaining_slips(specimen: Specimen) -> tuple[Slip, ...]:
    """Slips that explain a list, the most probable first; empty where none does or too many may.

    Slips with the same spectrum are claimed together: a square cantilever with its layup turned, or held at
    the neighbouring edge. Not tried for plates of several materials, unknown angles, labelled modes, or lists
    that may lack modes; empty if time runs out first.
    """
    measurement, _ = required(specimen)
    is_tried = measurement.complete and not measurement.names_modes and specimen.plate.mesh is None
    if specimen.plate.layup.n_unknown or not (is_tried and isinstance(specimen.material, Material)):
        return ()
    of_plate = list(_plates(specimen))
    share = P_SINGLE / (_OF_LIST + len({slip.kind for slip in of_plate}))
    try:
        weighed = [*_of_list(specimen, share), *_with_models(of_plate, share)]
    except (RigidBodyError, np.linalg.LinAlgError):
        return ()
    if is_time_up():
        return ()
    by_name = defaultdict[str, list[_Weighed]](list)
    for w in sorted(weighed, key=lambda w: -w.log_weight):
        by_name[w.name].append(w)
    log_weight = {name: logsumexp([w.log_weight for w in those]) for name, those in by_name.items()}
    whole = logsumexp(list(log_weight.values()))
    probability = {name: float(np.exp(weight - whole)) for name, weight in log_weight.items()}
    evidence = {
        name: float(log_weight[name] - np.log(sum(w.prior for w in those))) for name, those in by_name.items()
    }
    claim = claim_of(
        probability,
        evidence,
        lambda name: misfit_probability(by_name[name][0].marginal) > CLAIM_RULES.explained,
    )
    # of slips that are equally probable, the one tried first
    tried = sorted(claim.causes, key=[w.name for w in weighed].index)
    found = [(name, by_name[name][0].named) for name in tried]
    slips = [replace(slip, probability=probability[name]) for name, slip in found if slip is not None]
    is_claimed = claim.kind in ("named", "class") and len(found) == len(slips) <= _MOST
    return tuple(sorted(slips, key=lambda slip: -round(slip.probability, 3))) if is_claimed else ()


def _of_list(specimen: Specimen, share: float) -> Iterator[_Weighed]:
    """Hypotheses with the plate as stated: no slip, an unexplained residual, and corrected lists."""
    measurement, _ = required(specimen)
    case = plate_case(specimen, is_rough=True)
    of_list = tuple(effect for effect in CATALOGUE if effect.pairings)
    every = single_hypotheses(case.models.facts, measurement.size, complete=True, catalogue=of_list)
    named = {h.variant: _of_change(specimen, h.listed) for h in every}
    decimals = list(_decimals(specimen))
    points = [
        Hypothesis(_DECIMAL, "list", str(j), listed=change, prior=share / len(decimals))
        for j, (change, *_) in enumerate(decimals)
    ]
    whole = prior_by_cause(every)
    errors = [
        replace(h, prior=h.prior * share / whole[h.cause])
        for h in every
        if is_repairing(h) and len(h.listed.missed) < 2
    ]
    scan = Scan((case,), SCATTER, is_rough=True)
    scan.begin(every[0], (0,))
    scan.test([Trial(h, (0,)) for h in every if h.cause == OTHER])
    scan.test_pairings([(h, (0,)) for h in (*errors, *points)])
    for t in scan.tested:
        h = t.hypothesis
        if h.cause != _DECIMAL:
            slip = named[h.variant]
            name = h.cause if slip is None else f"{slip.kind} {slip.number}"
            yield _Weighed(name, slip, h.prior, t.marginal)
            continue
        # the density is of the frequencies as listed, not as they were meant
        _, factor, slip = decimals[int(h.variant)]
        of_slip = (replace(case, measurement=required(slip.corrected)[0]),)
        marginal = marginal_of(of_slip, every[0], (0,), known=t.marginal.z, log2_draws=0)
        marginal = replace(marginal, log_evidence=marginal.log_evidence + math.log(factor))
        yield _Weighed(f"{slip.kind} {slip.number} {factor:g}", slip, h.prior, marginal)


def _of_change(specimen: Specimen, change: ListChange) -> Slip | None:
    """The slip of a list error, None for no error."""
    measurement, _ = required(specimen)
    f = measurement.frequencies
    if change == ListChange():
        return None
    if change.spurious is None and not change.misread:
        return Slip("missed", change.missed[0] + 1, 0.0, specimen, {_COMPLETE: False})
    i = change.misread[0] if change.spurious is None else change.spurious
    less = replace(specimen, measurement=measurement.of_rows(np.delete(np.arange(len(f)), i)))
    edits: dict[KeyPath, Any] = {_LISTED: np.delete(f, i).tolist()}
    # dropping the last mode leaves the same list as dropping a false frequency
    if not change.misread and change.missed in ((), (len(f) - 1,)):
        return Slip("false", i + 1, float(f[i]), less, edits)
    return Slip("misread", i + 1, float(f[i]), less, {**edits, _COMPLETE: False})


def _decimals(specimen: Specimen) -> Iterator[tuple[ListChange, float, Slip]]:
    """Misplaced decimal points: the change of the list, the factor that corrects it, and the slip."""
    measurement, _ = required(specimen)
    f, n = measurement.frequencies, measurement.size
    # lists ascend: a point misplaced by two places or more makes a frequency the first or the last
    ends = {0: _FACTORS[1:], n - 1: tuple(1.0 / factor for factor in _FACTORS[1:])}
    for i in range(n):
        for factor in (_FACTORS[0], 1.0 / _FACTORS[0], *ends.get(i, ())):
            value = factor * float(f[i])
            moved = np.where(np.arange(n) == i, value, f)
            order = np.argsort(moved)
            listed = replace(measurement, frequencies=moved).of_rows(order)
            corrected = replace(specimen, measurement=listed)
            change = ListChange(missed=(int(np.flatnonzero(order == i)[0]),), spurious=i)
            slip = Slip("decimal", i + 1, value, corrected, {_LISTED: np.sort(moved).tolist()})
            yield change, factor, slip


def _with_models(tried: Sequence[Slip], share: float) -> Iterator[_Weighed]:
    """Corrected plates, each by its own plain model; share : prior probability of a kind of slip."""
    none = Hypothesis(NONE, NONE, prior=P_NONE)
    for slip in tried:
        if is_time_up():
            return
        try:
            if _left_by_a_step(slip.corrected) > _IN_SIGHT:
                continue
            marginal = marginal_of((plate_case(slip.corrected, is_rough=True),), none, (0,))
        except (PlateFileError, RigidBodyError, np.linalg.LinAlgError):
            continue
        prior = share / sum(other.kind == slip.kind for other in tried)
        yield _Weighed(f"{slip.kind} {slip.corrected.plate.edges}", slip, prior, marginal)


def _left_by_a_step(specimen: Specimen) -> float:
    """The relative rms misfit after one Gauss-Newton step from the reference constants.

    In log frequency, with the priors of the constants, on a coarse space without convergence control.
    """
    f, parameters = required(specimen)[0].frequencies, constant_parameters(specimen)
    problem = plate_problem(specimen, parameters)
    space = ritz_space(problem.edges, problem.nominal, _COARSE)
    every = np.ones(sum(sector.size for sector in space.sectors), dtype=bool)
    x = reference_vector(specimen, parameters)[None]
    found = model_on_basis(problem, x, len(f), np.zeros(len(f)), (_COARSE, every)).predict(x, jacobian=True)
    assert found.jacobian is not None
    sd = np.array([p.prior.sd for p in parameters.parameters])
    away = np.append(np.log(f / found.frequencies[0]), np.zeros(len(sd)))
    slope = np.vstack((found.jacobian[0] / found.frequencies[0][:, None] * sd, GROSS * np.eye(len(sd))))
    step = np.linalg.lstsq(slope, away)[0]
    return float(np.sqrt(np.mean((away - slope @ step)[: len(f)] ** 2)))


def _plates(specimen: Specimen) -> Iterator[Slip]:
    """Slips of the plate with the corrected plates."""
    for kind, plate, edits in _other_plates(specimen):
        yield Slip(kind, 0, 0.0, replace(specimen, plate=plate), edits)


def _other_plates(specimen: Specimen) -> Iterator[tuple[SlipKind, Plate, dict[KeyPath, Any]]]:
    plate = specimen.plate
    other = {"length": "width", "width": "length"}
    even = len(set(plate.edges)) == 1
    if plate.length != plate.width and not (even and specimen.material.isotropic):
        sd = {other.get(name, name): value for name, value in plate.sd.items()}
        exchanged: dict[KeyPath, dict[str, float]]
        exchanged = {("plate",): {"length": plate.width, "width": plate.length}}
        if other.keys() <= sd.keys():
            exchanged["plate", "sd"] = sd
        edits: dict[KeyPath, Any] = {
            (*table, f"{name}_mm"): round(to_user(name, values[name]), 9)
            for table, values in exchanged.items()
            for name in other
        }
        yield "sides", replace(plate, length=plate.width, width=plate.length, sd=sd), edits
    # with equal edges a turned layup has the spectrum of exchanged sides, or that of the plate, if it is bare
    if not specimen.material.isotropic and (specimen.sensors or not even):
        angles = np.array([a + 90.0 if a <= 0.0 else a - 90.0 for a in plate.layup.angles_deg])
        if not np.array_equal(angles, plate.layup.angles_deg):
            turned = from_angles(angles.tolist(), plate.layup.kinds)
            yield "layup", replace(plate, layup=turned), {("plate", "layup"): turned.text}
    if not even:
        edges = plate.edges[-1] + plate.edges[:-1]
        yield "edges", replace(plate, edges=edges), {("plate", "edges"): edges}
    held = plate.edges.translate(_OTHERWISE_HELD)
    if held != plate.edges:
        yield "supports", replace(plate, edges=held), {("plate", "edges"): held}
    if plate.edges != ALL_FREE:
        yield "free", replace(plate, edges=ALL_FREE), {("plate", "edges"): ALL_FREE}
        return
    # a bare plate turned by 180 degrees is the same plate
    for i in range(len(EDGES) if specimen.sensors else len(EDGES) // 2):
        edges = ALL_FREE[:i] + "C" + ALL_FREE[i + 1 :]
        yield "clamped", replace(plate, edges=edges), {("plate", "edges"): edges}


# Standard deviations from a bound within which a 95 % interval ends if the density is highest there.
_PUSHED: Final = 0.05


def pushed(constant: Constant) -> Constant:
    """A constant with the bound that the frequencies push it against, if any, and the verdict on it there.

    constant : with the interval of a posterior, which no bound cuts
    """
    if constant.interval is None or constant.verdict is Verdict.UNCONVERGED:
        return constant
    (low, high), prior, reach = constant.interval, constant.prior, _PUSHED * constant.sd
    at_lower, at_upper = low - prior.lower < reach, prior.upper - high < reach
    bound: Literal["lower", "upper"] | None = None
    if at_lower != at_upper:
        bound = "lower" if at_lower else "upper"
    explained = constant.verdict is not Verdict.MISFIT
    verdict = verdict_of(constant.sd, prior.sd, explained=explained, at_bound=bound is not None)
    return replace(constant, bound=bound, verdict=verdict)


def bound_slips(constants: Iterable[Constant]) -> tuple[Notice, ...]:
    """A notice of the constants that the frequencies push against a bound of their search interval."""
    bounds = tuple(
        (c.name, c.bound, c.prior.lower if c.bound == "lower" else c.prior.upper)
        for c in constants
        if c.bound is not None and c.verdict not in (Verdict.PRIOR, Verdict.UNCONVERGED)
    )
    return (Notice("at_bound", "slip", {"bounds": bounds}),) if bounds else ()


def without_own_prior(constant: Constant) -> Constant:
    """A constant with the value m and the sd s that it has without its own prior, all taken for normal.

    Of a posterior N(v, t^2) with the prior N(c, r^2) what else is known gives

        1 / s^2 = 1 / t^2 - 1 / r^2,  m = s^2 (v / t^2 - c / r^2)

    The constant itself where its prior has no centre, or where nothing else determines it.
    """
    prior = constant.prior.describe()
    if prior.centre is None or not constant.sd < prior.scale:
        return constant
    precision = constant.sd**-2 - prior.scale**-2
    value = (constant.value * constant.sd**-2 - prior.centre * prior.scale**-2) / precision
    return replace(constant, value=value, sd=precision**-0.5)


def corrected_texts(
    specimen: Specimen, slips: Sequence[Slip], name: str = "corrected.toml"
) -> dict[str, str]:
    """The plate file without its most probable slip, by file name; empty where it cannot be written."""
    text = corrected_file(specimen, slips[0]) if slips else None
    return {} if text is None else {name: text}


def corrected_file(specimen: Specimen, slip: Slip) -> str | None:
    """Text of a plate file without a slip; None where the file lacks the key to be changed.

    None too where a value does not stand on the line of its key, and for a changed list whose rows other keys
    number.
    """
    source = Path(specimen.source)
    if not source.is_file():
        return None
    text = decode(source.read_bytes(), specimen.source)
    lines = line_numbers(text)
    if _LISTED in slip.edits and any(path in lines for path in _NUMBERED):
        return None
    begin = [0, *(end.end() for end in re.finditer("\n", text))]
    # from the last line up, so that the offsets of earlier lines stay valid
    for path in sorted(slip.edits, key=lambda path: -lines.get(path, len(begin))):
        written = json.dumps(slip.edits[path])
        if path == _COMPLETE and path not in lines and _LISTED in lines:
            continue
        found = _VALUE.match(text, begin[lines[path] - 1]) if path in lines else None
        if found is None:
            return None
        text = f"{text[: found.start(1)]}{written}{text[found.end(1) :]}"
    if _COMPLETE in slip.edits and _COMPLETE not in lines:
        start = begin[lines[_LISTED] - 1]
        text = f"{text[:start]}complete = false\n{text[start:]}"
    try:
        content = tomllib.loads(text)
        is_edited = all(_at(content, path) == value for path, value in slip.edits.items())
    except (tomllib.TOMLDecodeError, KeyError):
        return None
    return text if is_edited else None


def _at(content: Any, path: KeyPath) -> Any:
    for key in path:
        content = content[key]
    return content
