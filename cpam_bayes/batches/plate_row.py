"""The row of one plate in a batch: its constants, their likelihood, the claim, or why there is no answer.

Finished rows are stored, so that a stopped batch resumes.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np

from cpam_bayes.answer import Verdict
from cpam_bayes.batches.limits import MarginalPosterior
from cpam_bayes.diagnosis.cases import hypotheses_of, plate_case
from cpam_bayes.diagnosis.diagnose import diagnose_cases
from cpam_bayes.effects import CATALOGUE
from cpam_bayes.formatting import with_spread
from cpam_bayes.forward_model.labels import labelled_model
from cpam_bayes.identification.point import PointEstimate
from cpam_bayes.inference.posterior import plate_posterior
from cpam_bayes.plate import Measurement, Specimen, to_user
from cpam_bayes.storage import read_sealed, set_aside, write_sealed

# Smallest relative solver error in a likelihood.
_SOLVER_FLOOR = 5e-5


@dataclass(frozen=True, slots=True)
class RowConstant:
    """One constant of a plate, SI.

    value, sd, low, high, verdict : as from `identify`; low and high are the 95 %
        interval, nan where none can be given
    posterior : normal with this value and sd, truncated at the bounds of the prior
    decided_by : the size whose standard deviation dominates the sd, "" where noise does
    """

    name: str
    value: float
    sd: float
    low: float
    high: float
    verdict: Verdict
    posterior: MarginalPosterior
    decided_by: str = ""

    @property
    def is_open(self) -> bool:
        """Whether the frequencies leave the constant undetermined."""
        return self.verdict not in (Verdict.DATA, Verdict.BOTH)

    @property
    def text(self) -> str:
        """Value +- sd, in plate-file units."""
        value, sd = with_spread(to_user(self.name, self.value), to_user(self.name, self.sd))
        return f"{value} +- {sd}{'' if self.verdict is Verdict.DATA else ' (open)'}"


@dataclass(frozen=True, slots=True)
class LocalLikelihood:
    """The likelihood of a plate's constants about its optimum, sizes marginalised.

    log p(list | c) = gradient . d - 1/2 d . information . d + constant, d = c - at

    at, gradient : (n,) SI; information : (n, n)
    """

    names: tuple[str, ...]
    at: tuple[float, ...]
    gradient: tuple[float, ...]
    information: tuple[tuple[float, ...], ...]


@dataclass(frozen=True, slots=True)
class PlateDiagnosis:
    """The claim about one plate, as in `diagnose`.

    size : of the most probable claimed cause in its most probable variant, SI, None where it has none
    """

    claim: str
    causes: tuple[str, ...]
    probability: float
    probability_none: float
    size: float | None = None


@dataclass(frozen=True, slots=True)
class PlateRow:
    """One plate of a batch.

    file : as given
    message : why it failed, or the warnings of its identification
    rms : of the relative residuals; noise : relative standard deviation that the intervals assume
    misfit : over the stated noise, as in `PointEstimate`; 1 where the noise explains it
    slip : of the plate file that explains the misfit, with the number of its mode or frequency
    density : kg/m3 of a weighed plate with its stated sizes
    certificate : laboratory, operator and date in its file
    remarks : possible errors of its list, and rows left out or added by hand
    all_rows : the constants with all rows of a list, where some were left out
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
    slip: tuple[str, int] | None = None
    density: float | None = None
    certificate: tuple[tuple[str, str], ...] = ()
    remarks: tuple[str, ...] = ()
    all_rows: tuple[RowConstant, ...] = ()

    @property
    def is_judged(self) -> bool:
        """Whether the plate model describes the list, so that the constants count."""
        return self.status == "done" and self.misfit == 1.0

    def constant(self, name: str) -> RowConstant | None:
        """A constant by its name."""
        return next((c for c in self.constants if c.name == name), None)

    def stored(self) -> bytes:
        """The row as bytes, read back by `row_of`."""
        return json.dumps(asdict(self), default=lambda verdict: verdict.value).encode()


def row_of(content: bytes) -> PlateRow:
    """The row stored as bytes; raises ``ValueError``, ``KeyError`` or ``TypeError`` for other content."""
    raw: dict[str, Any] = json.loads(content)
    constants, all_rows = (tuple(map(_row_constant, raw[key])) for key in ("constants", "all_rows"))
    likelihood, diagnosis = raw["likelihood"], raw["diagnosis"]
    return PlateRow(
        **{
            **raw,
            "constants": constants,
            "all_rows": all_rows,
            "remarks": tuple(raw["remarks"]),
            "likelihood": None if likelihood is None else _likelihood(likelihood),
            "slip": None if raw["slip"] is None else tuple(raw["slip"]),
            "certificate": tuple(map(tuple, raw["certificate"])),
            "diagnosis": None
            if diagnosis is None
            else PlateDiagnosis(**{**diagnosis, "causes": tuple(diagnosis["causes"])}),
        }
    )


def _row_constant(raw: Mapping[str, Any]) -> RowConstant:
    read = {"verdict": Verdict(raw["verdict"]), "posterior": MarginalPosterior(**raw["posterior"])}
    return RowConstant(**{**raw, **read})


def _likelihood(raw: Mapping[str, Any]) -> LocalLikelihood:
    information = tuple(tuple(row) for row in raw["information"])
    return LocalLikelihood(tuple(raw["names"]), tuple(raw["at"]), tuple(raw["gradient"]), information)


def failed_row(file: str, name: str, message: str) -> PlateRow:
    """The row of a plate without an answer."""
    return PlateRow(file, name, "failed", " ".join(message.split()))


def computed_row(
    file: str,
    estimate: PointEstimate,
    *,
    message: str = "",
    search: str = "",
    diagnosis: PlateDiagnosis | None = None,
    slip: tuple[str, int] | None = None,
) -> PlateRow:
    """The row of a plate from its point estimate.

    message : warnings of the identification; search : status of its swarms; slip : as in `PlateRow`
    """
    specimen = estimate.specimen
    likelihood = local_likelihood(estimate)
    return PlateRow(
        file=file,
        name=specimen.name,
        status="done",
        message=message,
        material=specimen.material.name or "",
        constants=tuple(
            RowConstant(
                c.name,
                c.value,
                c.sd,
                *((float("nan"),) * 2 if c.interval is None else c.interval),
                c.verdict,
                MarginalPosterior(c.value, c.sd, c.prior.lower, c.prior.upper),
                _decided_by(estimate, c.name, c.sd / c.value),
            )
            for c in estimate.constants
        ),
        likelihood=likelihood,
        diagnosis=diagnosis,
        rms=estimate.rms,
        noise=estimate.noise,
        search=search,
        misfit=estimate.misfit,
        slip=slip,
    )


def _decided_by(estimate: PointEstimate, constant: str, sd: float) -> str:
    """The size that contributes most of a constant's relative sd, "" where none does."""
    parts = {e.name: abs((e.sd or 0.0) * e.shift[constant]) for e in estimate.scale_errors}
    name = max(parts, key=lambda name: parts[name], default="")
    return name if name and parts[name] > sd / np.sqrt(2.0) else ""


def local_likelihood(estimate: PointEstimate) -> LocalLikelihood:
    """The likelihood about the swarm's optimum, with its noise, marginalised over [plate.sd].

    An error z of a size, in its standard deviations, shifts the constants that fit the list by B z. The
    integral of a Gaussian likelihood over z has information F - F B (1 + B^T F B)^-1 B^T F; the gradient
    likewise.
    """
    specimen = estimate.specimen
    measurement = specimen.measurement
    assert measurement is not None
    model = labelled_model(estimate.model, measurement, specimen)
    error = np.hypot(estimate.model.full.error, _SOLVER_FLOOR)
    posterior = plate_posterior(model, _with_noise(estimate, measurement), error)
    at = np.array([c.value for c in estimate.constants])
    expansion = posterior.expand_likelihood(at[None])
    g, f = expansion.gradient[0], expansion.curvature[0]
    known = [e for e in estimate.scale_errors if e.sd is not None]
    if known:
        b = np.array([[e.shift[c.name] * (e.sd or 0.0) * c.value for e in known] for c in estimate.constants])
        back = f @ b @ np.linalg.inv(np.eye(b.shape[1]) + b.T @ f @ b) @ b.T
        g, f = g - back @ g, f - back @ f
        f = 0.5 * (f + f.T)
    names = tuple(c.name for c in estimate.constants)
    return LocalLikelihood(names, tuple(at.tolist()), tuple(g.tolist()), tuple(map(tuple, f.tolist())))


def _with_noise(estimate: PointEstimate, measurement: Measurement) -> Measurement:
    """The measurement with the noise assumed by the intervals of the swarm, Birge's ratio included."""
    if measurement.frequency_sd is not None:
        return replace(measurement, frequency_sd=estimate.misfit * measurement.frequency_sd)
    level = estimate.noise if np.isfinite(estimate.noise) else estimate.rms
    return replace(measurement, relative_std=float(np.clip(estimate.misfit * level, 1e-6, 1.0)))


def diagnosed(specimen: Specimen, *, sets: bool = True) -> PlateDiagnosis:
    """The claim of a diagnosis, without gain, detection limits and further tests.

    sets : whether several causes at once are weighed
    """
    cases = [plate_case(specimen)]
    hypotheses = hypotheses_of(cases, CATALOGUE)
    found = diagnose_cases(cases, hypotheses=hypotheses, sets=sets, gain=False, power=False)
    none = found.weighed.by_cause().get("none", 0.0)
    claim = found.claim
    first = next((c for c in found.causes if c.name in claim.causes), None)
    sizes = [] if first is None else [first.parameters[p.name][0] for p in first.hypothesis.parameters[:1]]
    # the most probable first, as in the diagnosis
    named = [c.name for c in found.causes if c.name in claim.causes]
    return PlateDiagnosis(
        claim.kind,
        tuple(named) if len(named) == len(claim.causes) else tuple(claim.causes),
        float(claim.probability),
        float(none),
        float(sizes[0]) if sizes else None,
    )


# To be increased when the same inputs give other numbers.
_FORMAT: Final = 3


def row_key(specimen: Specimen, seed: int, diagnosis: bool | Literal["brief"], sources: str) -> str:
    """Hash of all inputs of a row: the plate as computed, its list, the seed.

    diagnosis : "brief" for that of a misfitting plate, without sets of causes
    sources : fingerprint of the code
    """
    measurement, plate = specimen.measurement, specimen.plate
    content: dict[str, Any] = {
        "format": _FORMAT,
        "sources": sources,
        "seed": seed,
        "diagnosis": diagnosis,
        "name": specimen.name,
        "plate": [repr(v) for v in (plate.length, plate.width, plate.thickness, plate.density, plate.mass)],
        "layup": [*(repr(float(a)) for a in plate.layup.angles_deg), *map(repr, plate.layup.kinds)],
        "edges": plate.edges,
        "sd": sorted(plate.sd.items()),
        "material": repr(specimen.material),
        "unknowns": repr(specimen.unknowns),
        "sensors": [repr(s) for s in specimen.sensors],
        "air": specimen.air_density,
        "measured": None
        if measurement is None
        else [
            measurement.frequencies.tolist(),
            measurement.resolution,
            measurement.relative_std,
            None if measurement.frequency_sd is None else measurement.frequency_sd.tolist(),
            list(measurement.labels),
            measurement.complete,
            _shapes(measurement),
            None if measurement.whole is None else measurement.whole.frequencies.tolist(),
        ],
    }
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:32]


def _shapes(measurement: Measurement) -> str | None:
    shapes = measurement.shapes
    if shapes is None:
        return None
    return hashlib.sha256(shapes.points.tobytes() + shapes.values.tobytes()).hexdigest()


def read_row(directory: Path | None, key: str) -> PlateRow | None:
    """The stored row of a plate; None where there is none or it is damaged, which is set aside."""
    if directory is None:
        return None
    path = _path(directory, key)
    try:
        content = read_sealed(path)
    except OSError:
        return None
    if content is None:
        return None
    try:
        return row_of(content)
    except (ValueError, KeyError, TypeError):
        set_aside(path)
        return None


def write_row(directory: Path | None, key: str, row: PlateRow) -> None:
    """Store a finished plate; silently skipped where the directory cannot be written."""
    if directory is None:
        return
    with suppress(OSError):
        directory.mkdir(parents=True, exist_ok=True)
        write_sealed(_path(directory, key), row.stored())


def _path(directory: Path, key: str) -> Path:
    return directory / f"{key}.plate"
