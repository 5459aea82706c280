"""Slips of a plate file that explain a gross misfit: a few corrected files are refitted and weighed.

Sides exchanged, a layup turned by 90 degrees, the neighbouring edges held, clamps that are simple supports or
the reverse, a free plate that was clamped at an edge or a held one that hung free, one error of the list. A
slip is named where the corrected file fits to the noise and every other slip that does is far less probable.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path
from typing import Any, Final, Literal, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.answer import Notice
from cpam_bayes.errors import LowFrequencyError, PlateFileError
from cpam_bayes.forward_model.build import basis_tolerance
from cpam_bayes.forward_model.model import converged_model, reference_constants, reference_vector
from cpam_bayes.forward_model.preconditions import birge_ratio, require_reachable
from cpam_bayes.forward_model.reduced import ReducedModel, ReductionSettings, reduce
from cpam_bayes.identification.search import PairedModel, refitted, required
from cpam_bayes.inference.swarm import material_swarm
from cpam_bayes.mechanics.convergence import Tolerance
from cpam_bayes.mechanics.modes import RigidBodyError
from cpam_bayes.parameters import ParameterSet
from cpam_bayes.plate import Plate, Specimen, to_user, unit_of
from cpam_bayes.plate.edges import ALL_FREE, EDGES
from cpam_bayes.plate.layup import Layup
from cpam_bayes.plate.text import decode, line_numbers
from cpam_bayes.running import is_time_up, single_blas_thread

__all__ = [
    "GROSS",
    "Slip",
    "SlipKind",
    "corrected_file",
    "corrected_texts",
    "explaining_slips",
    "require_reachable_or_slip",
    "slip_records",
    "with_slips",
]

Array = NDArray[Any]
SlipKind: TypeAlias = Literal[
    "sides", "layup", "edges", "supports", "clamped", "free", "missed", "false", "misread", "decimal"
]

GROSS: Final = 0.005
"""Relative misfit above which slips are tried, and below which a corrected list of unknown noise fits."""
# Frequencies beyond the unknowns that a corrected list has at least, so that its fit says something.
_LEAST_FREEDOM: Final = 2
# Relative error of the refits, and of the plate models behind them.
_REFIT_ERROR = 1e-3
_ROUGH: Final = Tolerance(kept=0.4 * _REFIT_ERROR, rich=0.3 * _REFIT_ERROR, largest_degree=14)
# Log odds of what is named over every other slip; standard deviations of [material.sd] that constants may be
# off.
_CLEAR, _FAR = 3.0, 4.0
# Slips that are named at most, of a list and of a plate, of which three may be one spectrum.
_MOST_OF_LIST, _MOST_OF_PLATE = 2, 3
# Places of a decimal point that was lost or put wrong.
_FACTORS: Final = (10.0, 100.0, 1000.0)
_OTHERWISE_HELD: Final = str.maketrans("CS", "SC")
# Constants that are drawn, those of them that a step is made from, its ridge over the trace of the square,
# and slips of the list that are refitted, those of which a step leaves least.
_DRAWN, _NEAR, _RIDGE, _REFITTED = 100, 12, 1e-6, 8
# A key with its value, up to a comment.
_VALUE: Final = re.compile(r"""[^=\n]*=\s*(\[[^\]]*\]|"[^"\n]*"|'[^'\n]*'|[^#\s]+)""")
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
    score : log probability of the list, up to a constant
    """

    kind: SlipKind
    number: int
    frequency: float
    corrected: Specimen
    edits: Mapping[tuple[str, str], Any]
    rms: float = math.nan
    score: float = -math.inf


class _Starts(NamedTuple):
    """Constants that a refit may begin from, (m, n), their frequencies, (m, n_modes), and their slopes."""

    constants: Array
    predicted: Array
    slopes: Array

    def led_on(self, f: Array, modes: Array, unknowns: ParameterSet) -> tuple[float, Array]:
        """What a Gauss-Newton step leaves of the logarithms of a list (n,), rms, and where it leads, (k, n).

        Of the constants whose frequencies are nearest; their best one and its start.
        """
        away = np.log(self.predicted[:, modes] / f)
        near = np.argsort(np.sum(away**2, axis=1), kind="stable")[:_NEAR]
        half = 0.5 * (unknowns.upper - unknowns.lower)
        slope = self.slopes[near][:, modes] / self.predicted[near][:, modes, None] * half
        square = np.swapaxes(slope, 1, 2) @ slope
        ridge = _RIDGE * np.trace(square, axis1=1, axis2=2)[:, None, None] * np.eye(len(half))
        step = -np.linalg.solve(square + ridge, np.einsum("mij,mi->mj", slope, away[near])[..., None])[..., 0]
        x = np.clip(self.constants[near] + half * step, unknowns.lower, unknowns.upper)
        left = away[near] + np.einsum("mij,mj->mi", slope, (x - self.constants[near]) / half)
        rms = np.sqrt(np.mean(left**2, axis=1))
        best = int(np.argmin(rms))
        return float(rms[best]), np.vstack((x[best], self.constants[near[[0, best]]]))


def with_slips(
    excess: tuple[Notice, ...], specimen: Specimen, rms: float, seed: int, announce: Callable[[str], None]
) -> tuple[tuple[Notice, ...], tuple[Slip, ...]]:
    """Notices of a misfit with the slips that explain it, and these slips; tried where the misfit is gross.

    rms : relative, of the fit. announce : is told that slips are tried
    """
    if not excess or rms <= GROSS or is_time_up():
        return excess, ()
    announce(f"the misfit of {specimen.name} is gross: trying slips of its file")
    slips = explaining_slips(specimen, seed)
    said = tuple((s.kind, s.number, s.frequency, s.corrected.plate.edges) for s in slips)
    facts = {"slips": said, "fit": max((s.rms for s in slips), default=0.0)}
    return tuple(replace(notice, facts={**notice.facts, **facts}) for notice in excess), slips


def require_reachable_or_slip(specimen: Specimen, seed: int) -> None:
    """Raise as `require_reachable` does, but for first frequencies that a slip of the plate file explains."""
    try:
        require_reachable(specimen)
    except LowFrequencyError:
        if not explaining_slips(specimen, seed):
            raise


def slip_records(slips: Iterable[Slip]) -> list[dict[str, Any]]:
    """Slips as a JSON document lists them."""
    return [
        {"slip": s.kind, "number": s.number, "frequency_hz": s.frequency, "rms_percent": 100.0 * s.rms}
        for s in slips
    ]


@single_blas_thread
def explaining_slips(specimen: Specimen, seed: int) -> tuple[Slip, ...]:
    """The slips that explain a list, the most probable first; empty where none does or too many do.

    Two are as probable where they are one spectrum: a square cantilever with its layup turned, or held at
    the neighbouring edge. Nothing is tried of unknown angles, of frequencies whose modes are labelled and of
    lists that may lack modes; nothing is said where time is up before all were tried.
    """
    measurement, _ = required(specimen)
    is_tried = measurement.complete and not measurement.names_modes and specimen.plate.mesh is None
    if specimen.plate.layup.n_unknown or not is_tried:
        return ()
    tried = []
    for slip in chain(_of_plate(specimen, seed), _of_list(specimen, seed)):
        if is_time_up():
            return ()
        tried.append(slip)
    by_score = sorted((slip for slip in tried if slip.score > -math.inf), key=lambda slip: slip.score)
    # one slip may be tried with several modes
    found = list({(slip.kind, slip.number, slip.corrected.plate.edges): slip for slip in by_score}.values())
    found.sort(key=lambda slip: -slip.score)
    first = [slip for slip in found if slip.score > found[0].score - _CLEAR]
    most = _MOST_OF_LIST if any(slip.number for slip in first) else _MOST_OF_PLATE
    return tuple(first) if len(first) <= most else ()


def _of_plate(specimen: Specimen, seed: int) -> Iterator[Slip]:
    """Corrected plates, each with a model of its own."""
    measurement, _ = required(specimen)
    n, tried = measurement.size, list(_plates(specimen))
    kinds = [kind for kind, _, _ in tried]
    for kind, plate, edits in tried:
        corrected = replace(specimen, plate=plate)
        try:
            model, starts = _model(corrected, n, seed)
        except (PlateFileError, RigidBodyError, np.linalg.LinAlgError):
            continue
        yield _weighed(
            Slip(kind, 0, 0.0, corrected, edits), PairedModel(model, np.arange(n)), starts, kinds.count(kind)
        )


def _plates(specimen: Specimen) -> Iterator[tuple[SlipKind, Plate, dict[tuple[str, str], Any]]]:
    plate = specimen.plate
    other = {"length": "width", "width": "length"}
    even = len(set(plate.edges)) == 1
    if plate.length != plate.width and not (even and specimen.material.isotropic):
        sd = {other.get(name, name): value for name, value in plate.sd.items()}
        sizes = {"length_mm": plate.width, "width_mm": plate.length}
        edits = {("plate", key): round(to_user(key[:-3], value), 9) for key, value in sizes.items()}
        yield "sides", replace(plate, length=plate.width, width=plate.length, sd=sd), edits
    # of equal edges that is the same spectrum as sides exchanged, or as the plate itself
    if not even and not specimen.material.isotropic:
        angles = np.array([a + 90.0 if a <= 0.0 else a - 90.0 for a in plate.layup.angles_deg])
        if not np.array_equal(angles, plate.layup.angles_deg):
            text = f"[{'/'.join(f'{a:g}' for a in angles)}]"
            turned = Layup(text, angles, plate.layup.unknown_index, plate.layup.kinds)
            yield "layup", replace(plate, layup=turned), {("plate", "layup"): text}
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


def _of_list(specimen: Specimen, seed: int) -> Iterator[Slip]:
    """Corrected lists, all with the model of the plate as it is stated."""
    measurement, _ = required(specimen)
    model, starts = _model(specimen, measurement.size + 1, seed)
    each = [
        (slip, modes, variants)
        for slip, modes, variants in _lists(specimen)
        if len(modes) - specimen.unknowns.size >= _LEAST_FREEDOM
    ]
    left = [
        starts.led_on(required(slip.corrected)[0].frequencies, modes, specimen.unknowns)[0]
        for slip, modes, _ in each
    ]
    for i in np.argsort(left, kind="stable")[:_REFITTED]:
        slip, modes, variants = each[i]
        yield _weighed(slip, PairedModel(model, modes), starts, variants)


def _lists(specimen: Specimen) -> Iterator[tuple[Slip, Array, int]]:
    """Slips of a list, with the rank of the mode of each frequency and the number of slips of the kind."""
    measurement, _ = required(specimen)
    f, n = measurement.frequencies, measurement.size
    every = np.arange(n + 1)
    for k in range(n):
        slip = Slip("missed", k + 1, 0.0, specimen, {("measurement", "complete"): False})
        yield slip, np.delete(every, k), n
    for i in range(n):
        less = replace(specimen, measurement=measurement.of_rows(np.delete(every[:n], i)))
        edits: dict[tuple[str, str], Any] = {("measurement", "frequencies_hz"): np.delete(f, i).tolist()}
        if i < n - 1:
            yield Slip("false", i + 1, float(f[i]), less, edits), every[: n - 1], n
        edits = {**edits, ("measurement", "complete"): False}
        # what is misread may stand at another place of a list that was sorted; without the last mode false
        for k in sorted({*range(n - 1), i}):
            slip = Slip("misread", i + 1, float(f[i]), less, edits)
            yield slip, np.delete(every[:n], k), n if k == i else n * n
    # in a list that ascends, a decimal point far off makes a frequency the first or the last
    ends = {0: _FACTORS[1:], n - 1: tuple(1.0 / factor for factor in _FACTORS[1:])}
    for i in range(n):
        for value in (factor * float(f[i]) for factor in (_FACTORS[0], 1.0 / _FACTORS[0], *ends.get(i, ()))):
            moved = np.where(every[:n] == i, value, f)
            listed = replace(measurement, frequencies=moved).of_rows(np.argsort(moved))
            right = replace(specimen, measurement=listed)
            edits = {("measurement", "frequencies_hz"): np.sort(moved).tolist()}
            slip = Slip("decimal", i + 1, value, right, edits)
            yield slip, every[:n], n


def _model(specimen: Specimen, n_modes: int, seed: int) -> tuple[ReducedModel, _Starts]:
    """A model of a plate about its reference constants, and constants to begin from."""
    measurement, unknowns = required(specimen)
    reduction = ReductionSettings(max(basis_tolerance(measurement), 0.1 * _REFIT_ERROR))
    full = converged_model(specimen, unknowns, n_modes, tolerance=_ROUGH, near=0, far=2)
    model = reduce(full, np.random.default_rng(0), reduction)
    drawn = material_swarm(specimen.material, unknowns, _DRAWN, np.random.default_rng([seed, 37]))
    centre = np.clip(reference_vector(specimen, unknowns), unknowns.lower, unknowns.upper)
    constants = np.vstack((centre, drawn))
    found = model.predict(constants, jacobian=True)
    assert found.jacobian is not None
    return model, _Starts(constants, found.frequencies, found.jacobian)


def _weighed(slip: Slip, model: PairedModel, starts: _Starts, variants: int) -> Slip:
    """A slip with its fit and score; -inf where the corrected file is not fitted to the noise.

    A frequency that is not compared with a mode could be anywhere within a factor of e. variants : places
    that a slip of this kind may have.
    """
    measurement, unknowns = required(slip.corrected)
    f, k = measurement.frequencies, unknowns.size
    freedom = len(f) - k
    if freedom < _LEAST_FREEDOM:
        return slip
    _, start = starts.led_on(f, model.modes, unknowns)
    x = refitted(slip.corrected, model, start)
    relative = model.predict(x[None]).frequencies[0, : len(f)] / f - 1.0
    rms = float(np.sqrt(np.mean(relative**2)))
    inferred = float(np.sqrt(np.sum(relative**2) / freedom))
    stated = measurement.relative_std is not None or measurement.frequency_sd is not None
    noise = measurement.noise_sd(measurement.relative_std or inferred) / f
    sd = np.sqrt(noise**2 + (measurement.resolution / f) ** 2 / 12.0 + _REFIT_ERROR**2)
    is_noise = birge_ratio(relative / sd, k) == 1.0 if stated else inferred <= GROSS
    if not is_noise or _is_far(slip.corrected, x):
        return replace(slip, rms=rms)
    fitted = -np.log(sd * math.sqrt(2.0 * math.pi)) - 0.5 * (relative / sd) ** 2
    return replace(slip, rms=rms, score=float(np.sum(fitted)) - math.log(variants))


def _is_far(specimen: Specimen, x: Array) -> bool:
    """Whether moduli among constants (n,) are none that [material.sd] allows."""
    reference, known = reference_constants(specimen), specimen.material.sd
    each = zip(specimen.unknowns.names, x.tolist(), strict=True)
    return any(unit_of(n) and abs(v - reference[n]) > _FAR * known.get(n, math.inf) for n, v in each)


def corrected_texts(
    specimen: Specimen, slips: Sequence[Slip], name: str = "corrected.toml"
) -> dict[str, str]:
    """The plate file without the most probable of its slips by its name; empty where it cannot be written."""
    text = corrected_file(specimen, slips[0]) if slips else None
    return {} if text is None else {name: text}


def corrected_file(specimen: Specimen, slip: Slip) -> str | None:
    """The text of a plate file without a slip; None where the file lacks what is to be changed.

    None too of a list that is changed and whose rows are numbered elsewhere in the file.
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
    return text
