"""Slips of a plate file that explain a gross misfit: hypotheses of the one density, with priors.

Sides exchanged, a layup turned by 90 degrees, the neighbouring edges held, clamps that are simple supports or
the reverse, a free plate that was clamped at an edge or a held one that hung free, each as the plain model of
another plate; the errors of a list as the catalogue has them, and a decimal point put wrong. They are weighed
against no slip, and no slip with something left over that nothing explains, and claimed as causes are.
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

from cpam_bayes.answer import Notice
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
# Causes of a list: its modes, a misreading, a decimal point.
_OF_LIST: Final = 3
# Slips that are named at most: three may be one spectrum.
_MOST: Final = 3
# Space on which other plates are tried, and the misfit, relative, of those that are worth a model.
_COARSE: Final = RitzSettings(10, 10, coupled=True)
_IN_SIGHT: Final = 0.03
# Places of a decimal point that was lost or put wrong.
_FACTORS: Final = (10.0, 100.0, 1000.0)
_OTHERWISE_HELD: Final = str.maketrans("CS", "SC")
# A key with its value, up to a comment.
_VALUE: Final = re.compile(r"""[^=\n]*=\s*(\[(?:[^\]#]|#[^\n]*)*\]|"[^"\n]*"|'[^'\n]*'|[^#\s]+)""")
_LISTED, _COMPLETE = ("measurement", "frequencies_hz"), ("measurement", "complete")
# Keys that number the rows of the list.
_NUMBERED: Final = (("measurement", "left_out"), ("measurement", "by_hand"))


@dataclass(frozen=True, slots=True, eq=False)
class Slip:
    """One slip, and the file without it.

    number : of the mode that is missed or of the frequency that is wrong, from 1; 0 for the plate
    frequency : Hz, as listed, or as it should be for a wrong decimal point
    corrected : the plate without the slip
    edits : (table, key) -> value of the corrected plate file
    rms : relative, of the corrected fit
    probability : of all slips, none, and none with a leftover
    """

    kind: SlipKind
    number: int
    frequency: float
    corrected: Specimen
    edits: Mapping[KeyPath, Any]
    rms: float = 0.0
    probability: float = 0.0


class _Weighed(NamedTuple):
    """A hypothesis with its evidence: a slip, none, or what is not named; variants have one name.

    slip : None for none and for a leftover
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
        """The slip with the misfit that it leaves."""
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
    """Notices of a misfit with the slips that explain it, and these slips; tried where the misfit is gross.

    rms : relative, of the fit. announce : is told that slips are tried
    known : as of `slips_where_unreachable`
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
    """The slips of the plate file that explain first frequencies below all of the plate; empty without these.

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
    """Slips as a JSON document lists them."""
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
    """The slips that explain a list, the most probable first; empty where none does or too many may.

    Two are claimed together where they are one spectrum: a square cantilever with its layup turned, or held
    at the neighbouring edge. Nothing is tried of several materials, of unknown angles, of frequencies whose
    modes are labelled, or of lists that may lack modes; nothing is said where time is up before that is done.
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
    found = [(name, by_name[name][0].named) for name in claim.causes]
    slips = [replace(slip, probability=probability[name]) for name, slip in found if slip is not None]
    is_claimed = claim.kind in ("named", "class") and len(found) == len(slips) <= _MOST
    return tuple(sorted(slips, key=lambda slip: -slip.probability)) if is_claimed else ()


def _of_list(specimen: Specimen, share: float) -> Iterator[_Weighed]:
    """No slip, with a leftover too, and corrected lists, all with the model of the plate as it is stated."""
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
        # a density of what was listed, not of what was meant
        _, factor, slip = decimals[int(h.variant)]
        of_slip = (replace(case, measurement=required(slip.corrected)[0]),)
        marginal = marginal_of(of_slip, every[0], (0,), known=t.marginal.z, log2_draws=0)
        marginal = replace(marginal, log_evidence=marginal.log_evidence + math.log(factor))
        yield _Weighed(f"{slip.kind} {slip.number} {factor:g}", slip, h.prior, marginal)


def _of_change(specimen: Specimen, change: ListChange) -> Slip | None:
    """The slip of a list with an error, None for none."""
    measurement, _ = required(specimen)
    f = measurement.frequencies
    if change == ListChange():
        return None
    if change.spurious is None and not change.misread:
        return Slip("missed", change.missed[0] + 1, 0.0, specimen, {_COMPLETE: False})
    i = change.misread[0] if change.spurious is None else change.spurious
    less = replace(specimen, measurement=measurement.of_rows(np.delete(np.arange(len(f)), i)))
    edits: dict[KeyPath, Any] = {_LISTED: np.delete(f, i).tolist()}
    # a frequency that is the last mode leaves the list that a false one does
    if not change.misread and change.missed in ((), (len(f) - 1,)):
        return Slip("false", i + 1, float(f[i]), less, edits)
    return Slip("misread", i + 1, float(f[i]), less, {**edits, _COMPLETE: False})


def _decimals(specimen: Specimen) -> Iterator[tuple[ListChange, float, Slip]]:
    """Decimal points put wrong: without the frequency, by which factor it is corrected, and the slip."""
    measurement, _ = required(specimen)
    f, n = measurement.frequencies, measurement.size
    # in a list that ascends, a decimal point far off makes a frequency the first or the last
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
    """Corrected plates, each the plain model of its own; share : prior probability of a kind."""
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
    """Misfit that a Gauss-Newton step from the reference constants leaves, rms, relative.

    Of the logarithms, with the priors of the constants, on a space that nothing was converged for.
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
    """Corrected plates."""
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
    # of equal edges that is the same spectrum as sides exchanged, or as the plate itself, where it is bare
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
    # turned by 180 degrees a bare plate is itself
    for i in range(len(EDGES) if specimen.sensors else len(EDGES) // 2):
        edges = ALL_FREE[:i] + "C" + ALL_FREE[i + 1 :]
        yield "clamped", replace(plate, edges=edges), {("plate", "edges"): edges}


def corrected_texts(
    specimen: Specimen, slips: Sequence[Slip], name: str = "corrected.toml"
) -> dict[str, str]:
    """The plate file without the most probable of its slips by its name; empty where it cannot be written."""
    text = corrected_file(specimen, slips[0]) if slips else None
    return {} if text is None else {name: text}


def corrected_file(specimen: Specimen, slip: Slip) -> str | None:
    """The text of a plate file without a slip; None where the file lacks what is to be changed.

    None too of a value that stands elsewhere than on the line of its key, and of a list that is changed and
    whose rows are numbered elsewhere in the file.
    """
    source = Path(specimen.source)
    if not source.is_file():
        return None
    text = decode(source.read_bytes(), specimen.source)
    lines = line_numbers(text)
    if _LISTED in slip.edits and any(path in lines for path in _NUMBERED):
        return None
    begin = [0, *(end.end() for end in re.finditer("\n", text))]
    # from the last line on, so that those before keep their places
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
