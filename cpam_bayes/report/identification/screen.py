"""The screen of `identify`: an engineer who reads nothing else must not be misled."""

from __future__ import annotations

import math

import numpy as np

from cpam_bayes.formatting import decimals_of, fixed, signed, significant, with_spread
from cpam_bayes.identification.angle_search import AngleSearchResult
from cpam_bayes.identification.identify import PointResult
from cpam_bayes.identification.point import PointEstimate
from cpam_bayes.identification.search import required
from cpam_bayes.plate import to_user, unit_of
from cpam_bayes.report.identification.words import noise_sentence, verdict_sentences
from cpam_bayes.report.modal_assurance.rows import assurance_sections
from cpam_bayes.report.plates.head import plate_section
from cpam_bayes.report.sections import COMPUTATION, Section
from cpam_bayes.report.tables import Table, facts, headed, remarks

_MISFIT = {
    "absolute": "sum of squared differences in Hz, eq. (7)",
    "relative": "sum of squared relative differences",
}
# Below this share of D11 a bending-twisting stiffness is rounding.
_ROUNDING = 1e-9


def sections(result: PointResult) -> tuple[Section, ...]:
    """Plate, frequencies, constants and what to believe of them, how they were found."""
    estimate = result.estimate
    several = len(result.optima) > 1
    return (
        plate_section(result.specimen, result.air_shifts),
        Section(
            "Measured and predicted frequencies",
            (_frequencies(result), _fit(estimate)),
            ("residuals",),
            folded=False,
        ),
        *assurance_sections(estimate.by_shape, result.specimen.measurement),
        Section("Mode shapes", figures=("modes", "predicted_against_measured")),
        Section(
            "Constants",
            (
                *(() if result.angles is None else (_angles(result.angles),)),
                _constants(estimate),
                *((_optima(result),) if several else ()),
                remarks("What the frequencies determine", verdict_sentences(estimate)),
                _laminate(estimate),
            ),
            ("optima",) if several else (),
        ),
        Section(COMPUTATION, (_search(result),)),
    )


def _angles(angles: AngleSearchResult) -> Table:
    n = len(angles.values)
    searched = "the fuzzy swarm" if n == 1 else f"{n} fuzzy swarms"
    rows = (
        ("layup", f"{angles.specimen.plate.layup.text} asked for"),
        ("unknown", "/".join(f"{a:g}" for a in angles.angles_deg) + f", found by {searched}"),
        ("status", angles.swarm.message),
        ("work", f"{angles.swarm.evaluations} forward solves in {angles.seconds:.1f} s"),
        ("others", "may explain the list as well or better: `sequence` gives each its probability"),
    )
    return facts("Angles", rows)


def _constants(result: PointEstimate) -> Table:
    columns = headed("name", "#value", "#sd", "unit", "#reference", "bounds", "verdict")
    rows = []
    for c in result.constants:
        value, sd = with_spread(to_user(c.name, c.value), to_user(c.name, c.sd))
        lower, upper = (f"{to_user(c.name, bound):.6g}" for bound in (c.lower, c.upper))
        verdict = c.verdict if c.bound is None else f"at its {c.bound} bound"
        if c.elsewhere and c.bound is None:
            verdict = "differs between optima"
        if not math.isfinite(c.sd) and c.bound is None:
            verdict = "sd not known"
        reference = f"{to_user(c.name, c.reference):.6g}"
        rows.append((c.name, value, sd, unit_of(c.name), reference, f"{lower} to {upper}", verdict))
    doubtful = frozenset(
        i for i, c in enumerate(result.constants) if c.verdict != "determined by the data" or c.elsewhere
    )
    return Table("Constants, point estimates", columns, tuple(rows), doubtful)


def _optima(result: PointResult) -> Table:
    names = [c.name for c in result.estimate.constants]
    units = [f"{name} {unit_of(name)}".rstrip() for name in names]
    size = required(result.specimen)[0].size
    unit, factor = ("%", 100.0) if result.residual == "relative" else ("Hz", 1.0)
    columns = headed(*(f"#{name}" for name in units), f"#rms {unit}", "#swarms")
    rows = tuple(
        (
            *(significant(to_user(name, values[name])) for name in names),
            significant(factor * math.sqrt(optimum.value / size), 3),
            f"{optimum.swarms} of {result.estimate.swarms}",
        )
        for optimum, values in result.optima
    )
    return Table("Optima that the noise does not tell apart", columns, rows)


def _frequencies(result: PointResult) -> Table:
    columns = headed("#mode", "label", "kind", "#measured Hz", "#predicted Hz", "#residual %")
    decimals = decimals_of(row.measured for row in result.frequencies)
    rows = tuple(
        (
            str(i),
            row.label,
            row.kind,
            fixed(row.measured, decimals),
            fixed(row.predicted, decimals + 1),
            signed(100 * row.residual, 2),
        )
        for i, row in enumerate(result.frequencies, 1)
    )
    return Table("Frequencies, residual = predicted / measured - 1", columns, rows)


def _fit(result: PointEstimate) -> Table:
    measurement = result.specimen.measurement
    assert measurement is not None
    predicted = np.array([mode.frequency for mode in result.predicted])
    rms = float(np.sqrt(np.mean((predicted - measurement.frequencies) ** 2)))
    rows = (
        ("rms residual", f"{significant(100 * result.rms, 3)} %, {significant(rms, 3)} Hz"),
        ("noise", noise_sentence(result)),
        ("sd", "linearised, from this noise; a systematic error of the plate model is not in it"),
        (
            "solver",
            f"error about {significant(100 * float(np.max(result.error)), 2)} % in the worst mode, "
            "estimated at these constants",
        ),
    )
    return facts("Fit", rows)


def _laminate(result: PointEstimate) -> Table:
    stiffness = result.laminate
    d = [name for name in stiffness if name.startswith("D")]
    moduli = [name for name in stiffness if name not in (*d, "nuxy")]
    small = _ROUNDING * abs(stiffness["D11"])
    rows = [
        (" ".join(d), ", ".join(_stiffness(stiffness[name], small) for name in d) + " N m"),
        (
            " ".join(moduli),
            ", ".join(significant(stiffness[name] / 1e9) for name in moduli) + " GPa",
        ),
        ("nuxy", significant(stiffness["nuxy"], 3)),
    ]
    return facts("Laminate in bending", tuple(rows))


def _stiffness(value: float, small: float) -> str:
    return "0" if abs(value) < small else significant(value)


def _search(result: PointResult) -> Table:
    swarm = result.estimate.swarm
    seconds = result.estimate.seconds
    rows = (
        ("minimised", _MISFIT[result.residual]),
        ("status", swarm.message),
        ("work", f"{swarm.evaluations} forward solves in {seconds:.1f} s, seed {result.seed}"),
    )
    return facts("Search", rows)
