"""The function `identify`: point estimates of constants and unknown ply angles by particle swarms."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any, ClassVar, Final, NamedTuple, TypeVar, overload

import numpy as np

from cpam_bayes.answer import Constant, FrequencyRow, Notice, Verdict
from cpam_bayes.errors import checked
from cpam_bayes.formatting import signed, significant
from cpam_bayes.forward_model.labels import labelled_model
from cpam_bayes.forward_model.model import air_shifts, with_references
from cpam_bayes.forward_model.preconditions import (
    count_slips,
    exchange_notices,
    explained_failures,
    high_noise_notices,
    misfit_slips,
    noise_slips,
    reference_contradictions,
    reference_slips,
    require_choice,
    require_paired_list,
    require_seed,
    require_supported,
    stated_slips,
)
from cpam_bayes.identification.angle_search import AngleSearchResult, search_angles
from cpam_bayes.identification.point import PointEstimate, estimate_constants, point_notices
from cpam_bayes.identification.search import MOST_SWARMS, NO_MESH, Optimum, Residual, required
from cpam_bayes.inference.sampling import arviz_data, by_user_name, described
from cpam_bayes.inference.swarm import SwarmResult, SwarmSettings
from cpam_bayes.plate import Measurement, PlateLike, Specimen, read_plate, to_user, unit_of, user_name
from cpam_bayes.questions.identify.joint import JointResult, identify_jointly
from cpam_bayes.questions.identify.slips import (
    Slip,
    bound_slips,
    corrected_texts,
    pushed,
    slip_records,
    slips_where_unreachable,
    with_slips,
    without_own_prior,
)
from cpam_bayes.render.figures import PREDICTED, new_figure
from cpam_bayes.render.plate import (
    assurance_drawings,
    assurance_sections,
    measured_modes,
    plate_section,
    shape_keys,
)
from cpam_bayes.render.report import (
    COMPUTATION,
    Caption,
    Column,
    Drawing,
    Report,
    Rows,
    Section,
    Table,
    facts,
    laminate_keys,
    plate_keys,
)
from cpam_bayes.render.sentences import (
    attached_step,
    bounds_step,
    constant_details,
    constant_keys,
    constant_rows,
    constants_headline,
    constants_table,
    correction_step,
    diagnose_step,
    errors_table,
    fit_sentence,
    frequency_columns,
    further_steps,
    gauge_step,
    intervals_sentence,
    mismatch_step,
    more_modes_step,
    plate_argument,
    references_said,
    reliance_table,
)
from cpam_bayes.result import PlateResult, present, within_time
from cpam_bayes.running import SILENT, Watch

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Estimate = TypeVar("Estimate")

# Draws of the stored posterior.
_EVEN_DRAWS: Final = 2000
RESIDUALS: Final = ("absolute", "relative", "whitened")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class PointResult(PlateResult):
    """Point estimates of the constants by the particle swarm.

    Attributes
    ----------
    specimen : with the angles found, where some were unknown
    estimate : the constants with their standard deviations, the fit, the swarm
    residuals : what was minimised, see `identify`
    angles : search for the unknown angles, None where all were known
    explained_by : slips of the plate file that explain its misfit, the most probable first
    """

    command: ClassVar[str] = "identify"

    estimate: PointEstimate
    residuals: Residual
    angles: AngleSearchResult | None = None
    explained_by: tuple[Slip, ...] = ()

    @property
    def status(self) -> str:
        """Either "converged", where two swarms found the best optimum, or "budget".

        A single swarm has converged when its particles agree. A search for angles must have converged too.
        """
        return self._decisive.status

    @property
    def message(self) -> str:
        """The status as a sentence."""
        return self._decisive.message

    @property
    def _decisive(self) -> SwarmResult:
        """The search that decides the status."""
        constants = self.estimate.swarm
        return constants if self.angles is None or constants.status != "converged" else self.angles.swarm

    @property
    def constants(self) -> Mapping[str, Constant]:
        """Name -> constant in SI, Pa or dimensionless; `to_dict` and `to_dataframe` have plate-file units."""
        return {c.name: c for c in self.estimate.constants}

    @property
    def optima(self) -> tuple[tuple[Optimum, dict[str, float]], ...]:
        """The best optimum and those the noise cannot distinguish from it, with their constants, SI."""
        names = [c.name for c in self.estimate.constants]
        return tuple((o, dict(zip(names, o.x.tolist(), strict=True))) for o in self.estimate.optima)

    @property
    def has_draws(self) -> bool:
        """True if there are posterior draws, which only whitened residuals give."""
        return self.estimate.draws is not None

    def to_arviz(self) -> Any:
        """Equally probable draws of the constants for arviz, one chain, as in ``posterior.nc``.

        From the posterior about all optima, with the usual errors of sizes and mass.
        """
        draws = self.estimate.draws
        if draws is None:
            return PlateResult.to_arviz(self)
        names = self.specimen.unknowns.names
        attributes, sizes = described(self.specimen, self.estimate.noise)
        groups = {
            "posterior": by_user_name(names, draws.even(_EVEN_DRAWS)[None]),
            "constant_data": sizes,
            "observed_data": {"frequencies_hz": required(self.specimen)[0].frequencies},
        }
        dims = {"frequencies_hz": ["mode"]}
        return arviz_data(self.command, self.specimen, self.seed, names, attributes, groups, dims, {})

    def texts(self) -> Mapping[str, str]:
        """The corrected plate file, without the slip that explains the misfit, where it can be written."""
        return corrected_texts(self.specimen, self.explained_by)

    def rms_of_optima(self) -> list[float]:
        """Root mean square of the relative residuals at each optimum."""
        if len(self.optima) < 2:
            return [self.estimate.rms] * len(self.optima)
        measurement, _ = required(self.specimen)
        model = labelled_model(self.estimate.model, measurement, self.specimen)
        predicted = model.predict(np.array([optimum.x for optimum, _ in self.optima])).frequencies
        residuals = predicted / measurement.frequencies - 1.0
        return [float(rms) for rms in np.sqrt(np.mean(residuals**2, axis=1))]

    @property
    def frequencies(self) -> tuple[FrequencyRow, ...]:
        """Measured and predicted frequencies, Hz, one row each."""
        measurement, _ = required(self.specimen)
        each = zip(measurement.frequencies, self.estimate.predicted, strict=True)
        return tuple(
            FrequencyRow(float(f), mode.frequency, mode.kind, mode.label, i)
            for i, (f, mode) in enumerate(each, 1)
        )


@overload
def identify(
    plate: PlateLike,
    /,
    *,
    seed: int = 0,
    residuals: Residual | None = None,
    swarms: int = MOST_SWARMS,
    settings: SwarmSettings | None = None,
    watch: Watch = SILENT,
) -> PointResult: ...


@overload
def identify(
    plate: PlateLike,
    second: PlateLike,
    /,
    *more: PlateLike,
    seed: int = 0,
    residuals: Residual | None = None,
    swarms: int = MOST_SWARMS,
    settings: SwarmSettings | None = None,
    scatter: float | None = None,
    watch: Watch = SILENT,
) -> JointResult: ...


@checked
@within_time
def identify(
    plate: PlateLike,
    *more: PlateLike,
    seed: int = 0,
    residuals: Residual | None = None,
    swarms: int = MOST_SWARMS,
    settings: SwarmSettings | None = None,
    scatter: float | None = None,
    watch: Watch = SILENT,
) -> PointResult | JointResult:
    """Elastic constants of a plate by particle swarms, eq. (1), (2) and (7), polished by derivatives.

    A single swarm may converge to a wrong optimum. Swarms are therefore run until two of them have found the
    best optimum of all; others that the noise cannot distinguish from it are listed. Unknown ply angles are
    searched with the constants by fuzzy swarms, eq. (3) to (5), in the same way, and then fixed. For the
    posterior see `sample`, on the command line ``identify --backend emcee``.

    Parameters
    ----------
    plate : a built-in name, a path, a table or a `Specimen`, see `read_plate`
    more : further plates of the material, or tests of the plate, which share the constants
    residuals : squares of these are minimised. "whitened", the default: over the scatter of noise, solver and
        theory; the constants are then those of the posterior about all optima, with the same prior as in
        every command, and the usual errors of what [plate.sd] leaves out; required for several plates.
        "absolute", in Hz, eq. (7), or "relative": the constants are linearised at the optimum within the
        bounds of [unknowns]
    swarms : most swarms to run, at least three are; 1 is the paper's single swarm as it ends, not polished
    settings : particles, iterations and weights of each swarm
    scatter : for several plates, relative standard deviation of a constant from plate to plate; 0.02 if left
        out
    watch : progress display; none if left out

    Raises
    ------
    ValueError
        If plates are not of one material or have different unknowns; if a plate cannot be read, has no
        measured frequencies or no unknowns, may lack modes (``complete = false``), or if no particle
        of the initial swarm is feasible.

    Examples
    --------
    >>> import cpam_bayes as cb
    >>> point = cb.identify("A1", seed=0)
    >>> point.status, round(point.constants["E1"].value / 1e9)
    ('converged', 68)
    """
    require_seed(seed)
    if swarms < 1:
        raise ValueError(f"swarms: received {swarms}, accepted: 1 or more")
    if more:
        require_choice("residuals", residuals or "whitened", ("whitened",))
        return identify_jointly((plate, *more), seed, swarms, settings or SwarmSettings(), scatter, watch)
    if scatter is not None:
        raise ValueError("scatter: received one plate, accepted: several; leave it out")
    residuals = residuals or "whitened"
    require_choice("residuals", residuals, RESIDUALS)
    specimen = require_paired_list(require_supported(read_plate(plate), NO_MESH, angles=True))
    if specimen.unknowns.root is not None and residuals != "whitened":
        raise ValueError(
            f'residuals: received "{residuals}" of a plate whose [material] has a former posterior, '
            'accepted: "whitened", which alone uses a prior; leave it out'
        )
    measurement, _ = required(specimen)
    known = slips_where_unreachable(specimen)
    if residuals == "whitened":
        specimen = with_references(specimen)
    settings = settings or SwarmSettings()
    unit, factor = _UNITS[residuals]

    def described(value: float) -> str:
        return f"rms misfit {factor * math.sqrt(value / measurement.size):.4g} {unit}"

    def watched(search: Callable[..., Estimate], of: Specimen, title: str, total: int) -> Estimate:
        with watch.stage(f"{title} {of.name}", total, described) as shown:
            return search(
                of, seed, settings=settings, residual=residuals, progress=shown.tick, notify=shown.notify
            )

    exchange = exchange_notices(specimen)
    angles: AngleSearchResult | None = None
    with explained_failures(specimen):
        if specimen.plate.layup.n_unknown:
            search = partial(search_angles, swarms=swarms)
            angles = watched(search, specimen, "angles of", swarms * settings.iterations)
            specimen = angles.known
        estimate = watched(
            partial(estimate_constants, swarms=swarms), specimen, "identify", swarms * settings.iterations
        )
    if residuals == "whitened":
        estimate = replace(estimate, constants=tuple(map(pushed, estimate.constants)))
    misfit = estimate.noise if estimate.noise_is_inferred else estimate.rms
    n, k = len(estimate.predicted), len(estimate.constants)
    unsure = [Notice("angles_disagree")] if angles is not None and angles.swarm.status == "budget" else []
    left = np.array([mode.frequency for mode in estimate.predicted]) / measurement.frequencies - 1.0
    excess = misfit_slips(misfit) or noise_slips(measurement, left, k)
    excess, explained_by = with_slips(excess, specimen, estimate.rms, watch.announce, known)
    # constants whose prior holds the reference are not compared with it: those from frequencies alone are
    determined = {
        c.name: (c.value, c.sd)
        for c in estimate.alone or estimate.constants
        if c.verdict in (Verdict.DATA, Verdict.MISFIT) and not c.elsewhere
    }
    # other residuals use no prior
    alone = map(without_own_prior, estimate.constants) if residuals == "whitened" else estimate.constants
    slips = (
        *stated_slips(specimen),
        *count_slips(n, k),
        *bound_slips(estimate.constants),
        *(() if explained_by else reference_contradictions(specimen, determined, alone)),
        *excess,
        *reference_slips(specimen),
    )
    return PointResult(
        seed=seed,
        notices=(
            *slips,
            *(() if slips or not estimate.noise_is_inferred else high_noise_notices(estimate.noise)),
            *unsure,
            *point_notices(estimate, residuals),
            *exchange,
        ),
        specimen=specimen,
        air_shifts=air_shifts(specimen),
        estimate=estimate,
        residuals=residuals,
        angles=angles,
        explained_by=explained_by,
    )


# Unit of a residual as minimised -> factor.
_UNITS: Final = {"absolute": ("Hz", 1.0), "relative": ("%", 100.0), "whitened": ("sd", 1.0)}
_MISFIT: Final = {
    "absolute": "sum of squared differences in Hz, eq. (7)",
    "relative": "sum of squared relative differences",
    "whitened": "sum of squared differences over their standard deviations (noise, solver, theory)",
}
# A bending-twisting stiffness below this fraction of D11 is rounding error.
_ROUNDING: Final = 1e-9


@present.register
def _present(result: PointResult) -> Report:
    estimate, specimen = result.estimate, result.specimen
    constants, plate = estimate.constants, specimen.plate
    frequencies, optima = _frequencies(result), _optima(result)
    several = len(optima.rows) > 1
    use = [c.name for c in constants if not c.is_open]
    steps = _steps(result, use)
    measurement, _ = required(specimen)
    inferred = estimate.noise_is_inferred
    return Report(
        summary=result.screen(
            headline=_headline(result),
            tables=(constants_table(constants),),
            lines=(
                fit_sentence(
                    estimate.rms,
                    stated=None if inferred else estimate.noise,
                    measurement=measurement,
                    inferred=estimate.noise if inferred else None,
                    explained=estimate.misfit == 1.0,
                    freedom=measurement.size - len(constants),
                ),
                *(
                    (intervals_sentence(plate, estimate.scale_errors, use, also=references_said(specimen)),)
                    if any(c.interval is not None for c in constants)
                    else ()
                ),
            ),
            next_step=steps[0],
        ),
        sections=(
            plate_section(specimen, result.air_shifts),
            Section(
                "Measured and predicted frequencies",
                (
                    frequencies.table("Frequencies, residual = predicted / measured - 1"),
                    _fit(estimate, result.residuals),
                ),
                ("residuals",),
                folded=False,
            ),
            *assurance_sections(estimate.by_shape, measurement),
            Section("Mode shapes", figures=("modes", "predicted_against_measured")),
            Section(
                "Constants",
                (
                    *(() if result.angles is None else (_angles(result.angles),)),
                    constant_details(constants, specimen.material, estimate.alone),
                    *((optima.table("Optima that fit equally well within the noise"),) if several else ()),
                    errors_table(estimate.scale_errors, [c.name for c in constants]),
                    reliance_table(estimate.reliances, lambda n: specimen.unknowns[n].prior, use),
                    _laminate(estimate.laminate),
                ),
                ("optima",) if several else (),
            ),
            further_steps(steps[1:]),
            Section(COMPUTATION, (_search(result),)),
        ),
        document=_document(result, frequencies, optima),
        drawings=_drawings(result),
        rows=(constant_rows(constants), frequencies, optima),
    )


def _headline(result: PointResult) -> str:
    said = constants_headline(result.estimate.constants, len(result.frequencies))
    if result.angles is None:
        return said
    angles = "/".join(f"{a:g}" for a in result.angles.angles_deg)
    return f"Best angles found: {angles}; others may fit as well. {said}"


def _steps(result: PointResult, use: Sequence[str]) -> tuple[str, ...]:
    specimen = result.specimen
    plate = plate_argument(specimen)
    mismatch = mismatch_step(specimen, result.notices, [row.label for row in result.frequencies])
    steps = [*bounds_step(result.notices), *mismatch]
    if result.explained_by:
        steps = [correction_step(result.texts())]
    posterior = f"get the posterior of the constants.  cpam-bayes identify {plate} --backend emcee"
    if result.angles is None:
        steps += [diagnose_step(specimen), posterior]
    elif not specimen.plate.layup.kinds:  # the other commands want a known layup
        steps += [
            f"how probable is each layup?  cpam-bayes sequence {plate}",
            f"all on one page, with the most probable layup.  cpam-bayes report {plate} --out DIR",
        ]
    steps += [*attached_step(specimen), *gauge_step(specimen, result.estimate.scale_errors, use)]
    if result.estimate.noise_is_inferred:
        steps.append("repeat the tap test and state its repeatability in the plate file.")
    return (*steps, *more_modes_step(result.estimate.constants))


class _OptimumRow(NamedTuple):
    """Constants, SI, at an optimum that the noise cannot rule out; rms : of the relative residuals there."""

    values: Mapping[str, float]
    optimum: Optimum
    rms: float


def _frequencies(result: PointResult) -> Rows:
    rows = result.frequencies
    return Rows("frequencies", frequency_columns(rows), rows)


def _optima(result: PointResult) -> Rows:
    """Optima that the noise cannot rule out, the best first: constants, misfit and swarms."""
    size = required(result.specimen)[0].size
    unit, factor = _UNITS[result.residuals]
    constants = (
        Column(
            f"{name} {unit_of(name)}".rstrip(),
            user_name(name),
            lambda row, name=name: to_user(name, row.values[name]),  # type: ignore[misc]
            significant,
            number=True,
        )
        for name in result.constants
    )
    columns = (
        *constants,
        Column(None, "objective", lambda row: row.optimum.value),
        Column(
            f"rms {unit}",
            None,
            lambda row: significant(factor * math.sqrt(row.optimum.value / size), 3),
            number=True,
        ),
        Column(None, "rms_percent", lambda row: 100.0 * row.rms),
        Column(
            "swarms",
            "found_by",
            lambda row: row.optimum.swarms,
            lambda n: f"{n} of {result.estimate.swarms}",
            number=True,
        ),
    )
    each = zip(result.optima, result.rms_of_optima(), strict=True)
    return Rows("optima", columns, tuple(_OptimumRow(values, o, rms) for (o, values), rms in each))


def _document(result: PointResult, frequencies: Rows, optima: Rows) -> dict[str, Any]:
    estimate, specimen, angles = result.estimate, result.specimen, result.angles
    return {
        **plate_keys(result.command, result.seed, specimen),
        "backend": "pso",
        "residuals": result.residuals,
        "status": result.status,
        "message": result.message,
        "constants": {user_name(c.name): constant_keys(c) for c in estimate.constants},
        **(
            {"frequencies_alone": {user_name(c.name): constant_keys(c) for c in estimate.alone}}
            if estimate.alone
            else {}
        ),
        **({} if angles is None else {"angles_deg": angles.angles_deg.tolist()}),
        "frequencies": frequencies.records(),
        "optima": [
            {"constants": {key: row.pop(key) for key in map(user_name, result.constants)}, **row}
            for row in optima.records()
        ],
        **shape_keys(estimate.by_shape, specimen.measurement),
        "explained_by": slip_records(result.explained_by),
        "rms_percent": 100.0 * estimate.rms,
        "noise_percent": 100.0 * estimate.noise,
        "noise_source": "residuals" if estimate.noise_is_inferred else "plate file",
        "relative_error_estimate": float(np.max(estimate.error)),
        "laminate": laminate_keys(estimate.laminate),
        "air_density_kg_m3": specimen.air_density,
        "forward_solves": estimate.swarm.evaluations + (0 if angles is None else angles.swarm.evaluations),
        "swarms": estimate.swarms,
        "iterations": estimate.swarm.iterations,
        "seconds": estimate.seconds + (0.0 if angles is None else angles.seconds),
        "warnings": list(result.warnings),
        "notes": list(specimen.notes),
    }


def _angles(angles: AngleSearchResult) -> Table:
    n = len(angles.values)
    searched = "the fuzzy swarm" if n == 1 else f"{n} fuzzy swarms"
    rows = (
        ("layup", f"{angles.specimen.plate.layup.text} asked for"),
        ("unknown", "/".join(f"{a:g}" for a in angles.angles_deg) + f", found by {searched}"),
        ("status", angles.swarm.message),
        ("work", f"{angles.swarm.evaluations} forward solves in {angles.seconds:.1f} s"),
        ("others", "may fit the list as well or better: `sequence` gives each its probability"),
    )
    return facts("Angles", rows)


def _fit(estimate: PointEstimate, residuals: Residual) -> Table:
    measurement, _ = required(estimate.specimen)
    predicted = np.array([mode.frequency for mode in estimate.predicted])
    rms = float(np.sqrt(np.mean((predicted - measurement.frequencies) ** 2)))
    worst = significant(100 * float(np.max(estimate.error)), 2)
    rows = (
        ("rms residual", f"{significant(100 * estimate.rms, 3)} %, {significant(rms, 3)} Hz"),
        ("noise", _noise(estimate, measurement)),
        ("sd", "of the posterior" if residuals == "whitened" else "linearised, from this noise"),
        ("solver", f"error about {worst} % in the worst mode, estimated at these constants"),
    )
    return facts("Fit", rows)


def _noise(estimate: PointEstimate, measurement: Measurement) -> str:
    """The noise behind the standard deviations, and its source."""
    if not math.isfinite(estimate.noise):
        return "not known"
    level = f"{significant(100 * estimate.noise, 2)} % of a frequency"
    rounding = f", and the rounding to {measurement.resolution:g} Hz" if measurement.resolution else ""
    if not estimate.noise_is_inferred:
        average = " on average" if measurement.frequency_sd is not None else ""
        return f"{level}{average}, as stated in the plate file{rounding}"
    n, k = measurement.size, len(estimate.constants)
    return f"{level}, inferred from the residuals of {n} frequencies minus {k} unknowns{rounding}"


def _laminate(stiffness: Mapping[str, float]) -> Table:
    """D11 to D26, the engineering constants in bending, nuxy."""
    moduli = ("Ex", "Ey", "Gxy")
    d = [name for name in stiffness if name not in (*moduli, "nuxy")]
    small = _ROUNDING * abs(stiffness["D11"])
    shown = ("0" if abs(stiffness[name]) < small else significant(stiffness[name]) for name in d)
    rows = (
        (" ".join(d), f"{', '.join(shown)} N m"),
        (" ".join(moduli), f"{', '.join(significant(stiffness[name] / 1e9) for name in moduli)} GPa"),
        ("nuxy", significant(stiffness["nuxy"], 3)),
    )
    return facts("Laminate in bending", rows)


def _search(result: PointResult) -> Table:
    swarm, seconds = result.estimate.swarm, result.estimate.seconds
    rows = (
        ("minimised", _MISFIT[result.residuals]),
        ("status", swarm.message),
        ("work", f"{swarm.evaluations} forward solves in {seconds:.1f} s, seed {result.seed}"),
    )
    return facts("Search", rows)


def _drawings(result: PointResult) -> tuple[Drawing, ...]:
    """Residuals first, then the fit, the modes, and the optima where there are several."""
    estimate, rows = result.estimate, result.frequencies
    n = len(rows)
    each = "; ".join(f"frequency {row.number}: {signed(100.0 * (row.residual or 0.0), 2)} %" for row in rows)
    band = ""
    if math.isfinite(estimate.noise):
        source = "inferred from these bars" if estimate.noise_is_inferred else "of the plate file"
        band = (
            f" The grey band is two standard deviations of the noise, {source}: a bar beyond it is more than "
            "noise."
        )
    optima = Drawing(
        "optima",
        partial(_optima_figure, result),
        Caption(
            "Each line is an optimum that fits as well as the best within the noise, over the search "
            "interval of each constant. Where lines diverge, the constant has more than one possible value.",
            f"{len(result.optima)} optima across the search intervals; the best has "
            f"F = {significant(result.optima[0][0].value, 3)}.",
        ),
    )
    return (
        Drawing(
            "residuals",
            partial(_residuals_figure, result),
            Caption(
                "Difference of each frequency after the fit: above zero it is predicted too high, below too "
                f"low.{band}",
                f"Residuals of {n} modes in percent. {each}.",
            ),
        ),
        Drawing(
            "predicted_against_measured",
            partial(_pairs_figure, result),
            Caption(
                "Each point is a mode; on the line the prediction equals the measurement. A point far from "
                "the line is a mode that the model gets wrong, or a frequency paired with another mode.",
                f"Predicted against measured frequencies of {n} modes with the line of equality.",
            ),
        ),
        measured_modes(result.specimen, rows, list(estimate.shapes), estimate.predicted),
        *assurance_drawings(result.specimen.name, estimate.by_shape, result.specimen.measurement),
        *((optima,) if len(result.optima) > 1 else ()),
    )


def _pairs_figure(result: PointResult) -> Figure:
    rows = result.frequencies
    measured = np.array([row.measured for row in rows])
    predicted = np.array([row.predicted for row in rows])
    figure = new_figure(5.2, 5.0)
    axes = figure.add_subplot()
    ends = (0.0, 1.12 * float(max(measured.max(), predicted.max())))
    axes.plot(ends, ends, color="0.6", linewidth=1, label="predicted = measured")
    axes.plot(measured, predicted, "o", color=PREDICTED, markersize=6, label="modes")
    for i, (row, *at) in enumerate(zip(rows, measured.tolist(), predicted.tolist(), strict=True)):
        # right and left in turn, so that labels of close modes do not overlap
        place, side = ((7, -8), "left") if i % 2 == 0 else ((-7, 3), "right")
        axes.annotate(
            row.label or "", (at[0], at[1]), place, textcoords="offset points", ha=side, fontsize="small"
        )
    axes.set(xlim=ends, ylim=ends, xlabel="measured, Hz", ylabel="predicted, Hz", aspect="equal")
    axes.set_title(f"{result.specimen.name}: predicted against measured", loc="left")
    axes.legend(loc="upper left", frameon=False)
    return figure


def _residuals_figure(result: PointResult) -> Figure:
    """The residual of each frequency, with the band of the noise."""
    estimate, rows = result.estimate, result.frequencies
    names = [f"{row.number}\n{row.label}".replace("+", "\n+") for row in rows]
    figure = new_figure(max(5.2, 0.8 * len(names)), 3.6)
    axes = figure.add_subplot()
    if np.isfinite(estimate.noise):
        two = 200.0 * estimate.noise
        source = "inferred from the residuals" if estimate.noise_is_inferred else "from the file"
        axes.axhspan(-two, two, color="0.9", label=f"2 standard deviations of the noise, {source}")
        axes.legend(loc="upper left", frameon=False, fontsize="small")
    axes.axhline(0.0, color="0.5", linewidth=1)
    axes.bar(np.arange(len(names)), [100.0 * (row.residual or 0.0) for row in rows], 0.5, color=PREDICTED)
    axes.set_xticks(np.arange(len(names)), names)
    axes.set(xlabel="mode", ylabel="predicted / measured - 1, %")
    axes.margins(y=0.25)
    axes.set_title(f"{result.specimen.name}: residuals, rms {100.0 * estimate.rms:.2f} %", loc="left")
    return figure


def _optima_figure(result: PointResult) -> Figure:
    """Position of each constant in its search interval at every optimum that the noise cannot rule out."""
    constants = result.estimate.constants
    figure = new_figure(5.8, 0.55 * len(constants) + 1.9)
    axes = figure.add_subplot()
    for k, (optimum, values) in enumerate(result.optima):
        share = [(values[c.name] - c.prior.lower) / (c.prior.upper - c.prior.lower) for c in constants]
        best = k == 0
        axes.plot(
            share,
            range(len(constants)),
            "o-" if best else "s--",
            color=PREDICTED if best else "0.55",
            markersize=7 if best else 4,
            linewidth=1.2 if best else 0.8,
            zorder=3 if best else 2,
            label=f"{'best' if best else 'other'}, F = {significant(optimum.value, 3)}" if k < 5 else None,
        )
        if best:
            for i, (x, c) in enumerate(zip(share, constants, strict=True)):
                text = f"{to_user(c.name, values[c.name]):.4g} {unit_of(c.name)}".rstrip()
                axes.annotate(text, (x, i), (0, 7), textcoords="offset points", ha="center", fontsize="small")
    axes.set_yticks(range(len(constants)), [c.name for c in constants])
    axes.set(xlim=(-0.03, 1.03), ylim=(len(constants) - 0.4, -0.7), xlabel="place in the search interval")
    axes.grid(axis="x", color="0.9")
    axes.set_title(f"{result.specimen.name}: optima that fit equally well within the noise", loc="left")
    figure.legend(loc="outside lower center", ncols=3, frameon=False, fontsize="small")
    return figure
