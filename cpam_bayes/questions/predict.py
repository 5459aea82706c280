"""The question `predict`: frequencies of another plate of the same material from a stored posterior."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any, ClassVar, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.answer import Notice
from cpam_bayes.command import MODES, PLATE, Command, option, whole
from cpam_bayes.errors import PlateFileError, checked
from cpam_bayes.formatting import listed, significant, with_spread
from cpam_bayes.forward_model.build import reduced_model
from cpam_bayes.forward_model.labels import MeasuredFrequency, measured_modes, measured_of_modes
from cpam_bayes.forward_model.model import SIZES, air_shifts, size_parameters
from cpam_bayes.forward_model.preconditions import (
    error_notices,
    explained_failures,
    rectangular_only,
    require_modes,
    require_seed,
    require_supported,
    require_whole,
    stated_slips,
)
from cpam_bayes.forward_model.three_dimensions import theory_bias
from cpam_bayes.mechanics.modes import Mode
from cpam_bayes.parameters import Parameter, ParameterSet, Uniform
from cpam_bayes.plate import PlateLike, Specimen, read_plate, to_user, unit_of, user_name
from cpam_bayes.plate.reader import builtin_names
from cpam_bayes.plate.stored_posterior import StoredPosterior, read_posterior, stored_posterior
from cpam_bayes.questions.identify.emcee import SampledResult
from cpam_bayes.render.figures import MEASURED, PREDICTED, extent_of, new_figure, shapes_figure
from cpam_bayes.render.plate import plate_section
from cpam_bayes.render.report import (
    COMPUTATION,
    Caption,
    Column,
    Drawing,
    Report,
    Rows,
    Section,
    facts,
    modes_caption,
    plate_keys,
)
from cpam_bayes.render.sentences import further_steps, plate_argument
from cpam_bayes.result import PlateResult, present
from cpam_bayes.running import SILENT, Watch, single_blas_thread

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = NDArray[Any]
PosteriorLike = str | os.PathLike[str] | SampledResult

MAX_DRAWS: Final = 20_000
DEFAULT_DRAWS: Final = 1000
# Smallest relative range of a parameter over which a model is built.
_LEAST_RANGE = 1e-6
# Relative difference from which a held constant counts as different from the posterior's.
_SAME = 1e-6
# A size measured again may differ by this many standard deviations.
_FAR_SD = 5.0


@dataclass(frozen=True, slots=True)
class PredictedMode:
    """The frequency of one mode over the posterior draws.

    mode : frequency (Hz), kind and label at the mean constants
    mean, sd, q025, q975 : of the natural frequency, Hz
    measured_q025, measured_q975 : the same for a measurement, with the noise of the posterior added, Hz
    """

    mode: Mode
    mean: float
    sd: float
    q025: float
    q975: float
    measured_q025: float
    measured_q975: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class PredictionResult(PlateResult):
    """Frequencies of a plate, predicted from the posterior of another.

    Attributes
    ----------
    posterior : the draws used
    modes : the lowest modes, ascending
    frequencies : (n_draws, n_modes) natural frequencies of the draws, Hz
    shapes : (n_modes, 3, n, n), u, v and w on a regular grid at the mean constants
    error : (n_modes,) estimated relative error of the solver
    sizes_of_posterior : whether the sizes are those of the draws, as in another test of the same plate
    seconds : wall clock
    """

    command: ClassVar[str] = "predict"

    posterior: StoredPosterior
    modes: tuple[PredictedMode, ...]
    frequencies: Array
    shapes: Array
    error: Array
    sizes_of_posterior: bool
    seconds: float


@checked
@single_blas_thread
def predict(
    posterior: PosteriorLike,
    plate: PlateLike,
    n_modes: int | None = None,
    *,
    draws: int = DEFAULT_DRAWS,
    seed: int = 0,
    watch: Watch = SILENT,
) -> PredictionResult:
    """Frequencies of a plate of another size, layup or edges, from the posterior of its material.

    Every draw of the constants is propagated through the plate model: p(f | data) = integral of
    p(f | constants) p(constants | data). Constants that did not vary in the posterior are taken from the
    plate's [material]. Sizes vary by [plate.sd], or else by the usual standard deviations; for
    the measured plate itself, recognised by its `specimen`, they are those of the draws.

    Parameters
    ----------
    posterior : path of a ``posterior.nc``, or the result of `sample`
    plate : a built-in name, a path, a table or a `Specimen`, see `read_plate`
    n_modes : number of modes; as many as were measured, or 10, if left out
    draws : largest number of posterior draws, evenly spaced
    watch : progress display; none if left out

    Raises
    ------
    ValueError
        If the posterior or the plate cannot be read, or they are of different kinds of material.

    Examples
    --------
    >>> import cpam_bayes as cb
    >>> post = cb.sample("A1", seed=0)
    >>> first = cb.predict(post, "A2", n_modes=1).modes[0]
    >>> print(first.q025 < first.mean < first.q975, first.mode.kind)
    True bending
    """
    _require_order(posterior, plate)
    require_seed(seed)
    require_modes(n_modes)
    require_whole("draws", draws, 2, MAX_DRAWS)
    specimen = require_supported(read_plate(plate), rectangular_only("predict"))
    if isinstance(posterior, SampledResult):
        stored = stored_posterior(posterior.to_arviz(), posterior.title)
    else:
        stored = read_posterior(posterior)
    stored = stored.thinned(draws)
    _require_same_kind(specimen, stored)
    watch.announce(f"predict {specimen.name} from {stored.source}: {stored.size} draws")
    with explained_failures(specimen):
        return _predicted(specimen, stored, n_modes or measured_modes(specimen), seed, watch.announce)


def _require_order(posterior: PosteriorLike, plate: object) -> None:
    """Refuse posterior and plate in the wrong order."""
    if isinstance(plate, SampledResult) or (
        isinstance(plate, str | os.PathLike) and os.fspath(plate).endswith(".nc")
    ):
        shown = f"of {plate.title}" if isinstance(plate, SampledResult) else os.fspath(plate)
        raise ValueError(
            f"plate: received the posterior {shown}, accepted: the posterior first, then the plate, as in "
            "predict posterior.nc panel.toml"
        )
    if not isinstance(posterior, SampledResult) and (
        os.fspath(posterior) in builtin_names() or os.fspath(posterior).endswith(".toml")
    ):
        raise ValueError(
            f"posterior: received the plate {os.fspath(posterior)}, accepted: the posterior first, then the "
            "plate, as in predict posterior.nc panel.toml"
        )


def _predicted(
    specimen: Specimen, stored: StoredPosterior, n_modes: int, seed: int, notify: Callable[[str], None]
) -> PredictionResult:
    start = time.perf_counter()
    rng = np.random.default_rng(seed)
    same_name = bool(stored.sizes) and stored.specimen == specimen.specimen
    differing = _differing_sizes(specimen, stored) if same_name else ()
    same_plate = same_name and not differing
    drawn = {name: stored.draws[name] for name in stored.constants}
    drawn |= _sizes(specimen, stored, same_plate, rng)
    possible = specimen.material.admissible(drawn)
    if np.count_nonzero(possible) < 2:
        raise ValueError(
            f"{specimen.source}: no draw of {stored.source} is a possible material with the other "
            "constants of [material]; give those that were held fixed there"
        )
    parameters = ParameterSet(tuple(_over(name, values) for name, values in drawn.items()))
    x = parameters.vector(drawn)[possible]
    centre = x.mean(axis=0)
    bias = theory_bias(specimen)
    model = reduced_model(specimen, parameters, n_modes, centre=centre, bias=bias, notify=notify)
    f = model.predict(x).frequencies
    described = model.full.modes(centre)
    error = model.full.error
    return PredictionResult(
        seed=seed,
        notices=(
            *stated_slips(specimen),
            *differing,
            *_held_elsewhere(specimen, stored),
            *error_notices(error),
        ),
        specimen=specimen,
        air_shifts=air_shifts(specimen),
        posterior=stored,
        modes=_modes(described, f, _measured(f, stored, possible, rng)),
        frequencies=f,
        shapes=model.full.shapes(centre),
        error=error,
        sizes_of_posterior=same_plate,
        seconds=time.perf_counter() - start,
    )


def _differing_sizes(specimen: Specimen, stored: StoredPosterior) -> tuple[Notice, ...]:
    """Notice of sizes that differ from the measured plate of the same name."""
    far = []
    for name, there in stored.outline.items():
        here = float(getattr(specimen.plate, name))
        if abs(here - there) > _FAR_SD * specimen.plate.sd.get(name, 0.0) + _SAME * there:
            far.append((name, here, there))
    if not far:
        return ()
    return (Notice("other_sizes", facts={"plate": specimen.name, "sizes": tuple(far)}),)


def _sizes(
    specimen: Specimen, stored: StoredPosterior, same_plate: bool, rng: np.random.Generator
) -> dict[str, Array]:
    """Draws of the uncertain sizes of the plate, SI."""
    if same_plate:
        return {name: stored.draws[name] for name in stored.sizes}
    known = replace(specimen, plate=replace(specimen.plate, sd=specimen.plate.known_to))
    return {p.name: p.prior.sample(rng, stored.size) for p in size_parameters(known).parameters}


def _over(name: str, values: Array) -> Parameter:
    """A parameter, uniform over the range of its draws."""
    low, high = float(values.min()), float(values.max())
    room = _LEAST_RANGE * max(abs(low), abs(high))
    return Parameter(name, SIZES.get(name, ""), Uniform(low - room, high + room))


def _measured(f: Array, stored: StoredPosterior, possible: Array, rng: np.random.Generator) -> Array:
    """Simulated measurements (n_draws, n_modes): frequencies with the noise of the posterior, Hz."""
    z = rng.standard_normal(f.shape)
    if "absolute_sd" in stored.draws:
        return np.asarray(f + stored.draws["absolute_sd"][possible, None] * z)
    relative = stored.draws.get("relative_std")
    level = (stored.repeatability or 0.0) if relative is None else relative[possible, None]
    return np.asarray(f * (1.0 + level * z))


def _modes(described: tuple[Mode, ...], f: Array, measured: Array) -> tuple[PredictedMode, ...]:
    mean, sd = f.mean(axis=0), f.std(axis=0, ddof=1)
    low, high = np.quantile(f, (0.025, 0.975), axis=0)
    lower, upper = np.quantile(measured, (0.025, 0.975), axis=0)
    columns = (mean, sd, low, high, lower, upper)
    return tuple(
        PredictedMode(mode, *(float(column[k]) for column in columns)) for k, mode in enumerate(described)
    )


def _require_same_kind(specimen: Specimen, stored: StoredPosterior) -> None:
    """Refuse a plate whose material is of another kind than the posterior's."""
    symmetry = specimen.material.symmetry
    foreign = [name for name in stored.constants if name not in specimen.material.constants]
    foreign = [name for name in foreign if name not in ("G13", "G23") or symmetry == "isotropic"]
    other = bool(stored.symmetry) and stored.symmetry != symmetry
    if not (other or foreign):
        return
    of = stored.symmetry or f"with {listed(stored.constants, 'and')}"
    raise PlateFileError(
        f"{specimen.source}: the material is {symmetry}, that of {stored.source} is {of}; a posterior is "
        "for one kind of material: give [material] the same symmetry"
    )


def _held_elsewhere(specimen: Specimen, stored: StoredPosterior) -> tuple[Notice, ...]:
    """Notice of constants held at other values in the posterior than this plate has."""
    values = specimen.material.complete()
    differing = tuple(
        (name, value, float(values[name]))
        for name, value in stored.held.items()
        if abs(float(values[name]) / value - 1.0) > _SAME
    )
    return (Notice("other_constants", facts={"constants": differing}),) if differing else ()


class _Row(NamedTuple):
    """A predicted mode and its measured frequency, if any."""

    number: int
    m: PredictedMode
    measured: MeasuredFrequency | None

    @property
    def is_outside(self) -> bool:
        """Whether the measured frequency lies outside the 95 % interval of a measurement."""
        there = self.measured
        return there is not None and not self.m.measured_q025 <= there.hz <= self.m.measured_q975


def _interval(m: PredictedMode, low: float, high: float) -> str:
    return " to ".join(with_spread(v, m.sd)[0] for v in (low, high))


_MODES: Final = (
    Column("mode", None, lambda r: r.number, number=True),
    Column("Hz", None, lambda r: with_spread(r.m.mean, r.m.sd)[0], number=True),
    Column("sd", None, lambda r: with_spread(r.m.mean, r.m.sd)[1], number=True),
    Column("95 % interval", None, lambda r: _interval(r.m, r.m.q025, r.m.q975)),
    Column("of a measurement", None, lambda r: _interval(r.m, r.m.measured_q025, r.m.measured_q975)),
    Column(None, "mean_hz", lambda r: r.m.mean),
    Column(None, "sd_hz", lambda r: r.m.sd),
    Column(None, "q025", lambda r: r.m.q025),
    Column(None, "q975", lambda r: r.m.q975),
    Column(None, "measured_q025", lambda r: r.m.measured_q025),
    Column(None, "measured_q975", lambda r: r.m.measured_q975),
    Column("kind", "kind", lambda r: r.m.mode.kind),
    Column("label", "label", lambda r: r.m.mode.label),
    Column("measured Hz", "measured_hz", lambda r: r.measured and r.measured.hz, lambda f: f"{f:.10g}", True),
    Column("", None, lambda r: "outside" if r.is_outside else None),
    Column(None, "paired_by", lambda r: r.measured and r.measured.by),
)
# Columns of (name, mean, sd) of a constant, in plate-file units.
_CONSTANTS: Final = (
    Column("", "name", lambda c: c[0]),
    Column("value", None, lambda c: f"{with_spread(c[1], c[2])[0]} {unit_of(c[0])}".rstrip()),
    Column("sd", None, lambda c: with_spread(c[1], c[2])[1], number=True),
    Column(None, "mean", lambda c: c[1]),
    Column(None, "sd", lambda c: c[2]),
)


@present.register
def _present(result: PredictionResult) -> Report:
    specimen, stored = result.specimen, result.posterior
    measured = measured_of_modes(specimen, [m.mode for m in result.modes])
    rows = tuple(_Row(i, *each) for i, each in enumerate(zip(result.modes, measured, strict=True), 1))
    frequencies = Rows("frequencies", _MODES, rows, lambda row: row.is_outside)
    moments = {name: (draws.mean(), draws.std(ddof=1)) for name, draws in stored.draws.items()}
    constants = Rows(
        "constants",
        _CONSTANTS,
        tuple((n, *(to_user(n, float(v)) for v in moments[n])) for n in stored.constants),
    )
    worst = float(np.max(result.error))
    first, *further = (*_steps(specimen), "")
    computation = (
        ("solver", "Ritz, first-order shear deformation, on a reduced basis"),
        ("error", f"about {significant(100.0 * worst, 2)} % of a frequency in the worst mode, estimated"),
        ("draws", str(len(result.frequencies))),
        ("time", f"{result.seconds:.1f} s"),
    )
    return Report(
        summary=result.screen(
            headline=_headline(rows),
            tables=(frequencies.table("Predicted frequencies"),),
            lines=(f"{_contained(result)} {_noise(stored)}",),
            next_step=first,
        ),
        sections=(
            plate_section(specimen, result.air_shifts),
            Section(
                "Predicted frequencies",
                (constants.table(f"Constants, {len(result.frequencies)} draws of {_origin(stored)}"),),
                ("prediction",),
                folded=False,
            ),
            Section("Modes", (), ("modes",), folded=False),
            further_steps([step for step in further if step]),
            Section(COMPUTATION, (facts("Computation", computation),)),
        ),
        document={
            **plate_keys(result.command, result.seed, specimen),
            "posterior": {
                "source": stored.source,
                "plate": stored.plate,
                "specimen": stored.specimen,
                "draws": len(result.frequencies),
                "constants": {user_name(n): {"mean": mean, "sd": sd} for n, mean, sd in constants.rows},
            },
            "sizes_of_posterior": result.sizes_of_posterior,
            "frequencies": frequencies.records(),
            "relative_error_estimate": worst,
            "air_density_kg_m3": specimen.air_density,
            "seconds": result.seconds,
            "warnings": list(result.warnings),
            "notes": list(specimen.notes),
        },
        drawings=(
            Drawing(
                "prediction",
                partial(_intervals_figure, result, rows),
                Caption(
                    "Thick bars: 95 % interval of the natural frequency of each mode, relative to its mean. "
                    "Thin bars: 95 % interval of a measurement of it. Dots: measured frequencies; one "
                    "outside its thin bar contradicts the posterior or the plate file.",
                    f"Intervals of {len(rows)} predicted frequencies.",
                ),
            ),
            Drawing(
                "modes",
                partial(_shapes_figure, result),
                modes_caption([(m.mean, m.mode.label or m.mode.kind) for m in result.modes]),
            ),
        ),
        rows=(frequencies, constants),
    )


def _headline(rows: Sequence[_Row]) -> str:
    relative = [row.m.sd / row.m.mean for row in rows]
    low, high = (significant(100.0 * v, 2) for v in (min(relative), max(relative)))
    many = "1 frequency" if len(rows) == 1 else f"{len(rows)} frequencies"
    said = f"{many} predicted, standard deviation {low if low == high else f'{low} to {high}'} %."
    pairs = [row for row in rows if row.measured is not None]
    inside = sum(not row.is_outside for row in pairs)
    if not pairs:
        return said
    return f"{said} {inside} of {len(pairs)} measured frequencies lie within the interval of a measurement."


def _origin(stored: StoredPosterior) -> str:
    return f"{stored.plate} in {stored.source}" if stored.plate else stored.source


def _contained(result: PredictionResult) -> str:
    """Sentence on the uncertainties contained in the intervals."""
    if result.sizes_of_posterior:
        sizes, exact = [*result.posterior.sizes], ""
    else:
        sizes = [name for name, sd in result.specimen.plate.known_to.items() if sd > 0.0]
        exact = "" if sizes else "; sizes and mass are exact"
    return f"The intervals contain {listed(['the constants', *sizes], 'and')}{exact}."


def _noise(stored: StoredPosterior) -> str:
    """Sentence on the noise of a measurement, relative or in Hz, and what it leaves out."""
    relative = stored.draws.get("relative_std")
    if "absolute_sd" in stored.draws:
        level = f"{significant(float(stored.draws['absolute_sd'].mean()), 2)} Hz"
    elif relative is not None:
        level = f"{significant(100.0 * float(relative.mean()), 2)} %"
    elif stored.repeatability is not None:
        level = f"{significant(100.0 * stored.repeatability, 2)} %"
    else:
        return "Measurement noise is unknown."
    return f"A measurement adds noise of {level}. Not contained: model errors specific to this plate."


def _steps(specimen: Specimen) -> tuple[str, ...]:
    plate = plate_argument(specimen)
    steps = []
    if specimen.measurement is None:
        steps.append("measure the plate and add its frequencies to its file, to compare.")
    elif specimen.unknowns.size:
        steps.append(f"do its own frequencies give the same constants?  cpam-bayes identify {plate}")
    if specimen.unknowns.size:
        steps.append(f"which specimen would say more?  cpam-bayes design {plate}")
    return tuple(steps)


def _shapes_figure(result: PredictionResult) -> Figure:
    plate = result.specimen.plate
    return shapes_figure(
        f"{result.specimen.name}, edges {plate.edges}: predicted modes",
        [
            f"{i}: {m.mean:.6g} +- {m.sd:.2g} Hz\n{m.mode.kind} {m.mode.label}"
            for i, m in enumerate(result.modes, 1)
        ],
        list(result.shapes),
        [m.mode.in_plane_fraction > 0.5 for m in result.modes],
        extent_of(plate.length, plate.width),
        plate.edges,
    )


def _intervals_figure(result: PredictionResult, rows: Sequence[_Row]) -> Figure:
    """95 % intervals of each mode relative to its mean, for the frequency and for a measurement."""
    modes, at = result.modes, np.arange(len(rows))
    figure = new_figure(5.8, 0.34 * len(modes) + 1.5)
    axes = figure.add_subplot()

    def percent(values: Sequence[float]) -> Array:
        return np.array([100.0 * (v / m.mean - 1.0) for v, m in zip(values, modes, strict=True)])

    axes.hlines(
        at,
        percent([m.measured_q025 for m in modes]),
        percent([m.measured_q975 for m in modes]),
        color="0.6",
        linewidth=1.2,
        label="a measurement, 95 %",
    )
    axes.hlines(
        at,
        percent([m.q025 for m in modes]),
        percent([m.q975 for m in modes]),
        color=PREDICTED,
        linewidth=5,
        label="natural frequency, 95 %",
    )
    shown = [
        (k, 100.0 * (row.measured.hz / row.m.mean - 1.0))
        for k, row in enumerate(rows)
        if row.measured is not None
    ]
    if shown:
        place, off = zip(*shown, strict=True)
        axes.plot(off, place, "o", color=MEASURED, markersize=4, label="measured")
    axes.set_yticks(at, [f"{m.mode.label or m.mode.kind}  {m.mean:.5g} Hz" for m in modes])
    axes.set(ylim=(len(modes) - 0.4, -0.6), xlabel="frequency / predicted mean - 1, %")
    axes.grid(axis="x", color="0.9")
    axes.set_axisbelow(True)
    axes.set_title(
        f"{result.specimen.name}: predicted from {result.posterior.plate or 'the posterior'}", loc="left"
    )
    figure.legend(loc="outside lower center", ncols=3, frameon=False, fontsize="small")
    return figure


COMMAND: Final = Command(
    predict,
    (
        option(
            "posterior",
            metavar="POSTERIOR",
            help="posterior.nc of `identify --out DIR`, of a plate of the same material",
        ),
        PLATE,
        MODES,
        option(
            "--draws",
            type=whole(2, MAX_DRAWS),
            default=DEFAULT_DRAWS,
            metavar="N",
            help=f"posterior draws at most, 2 to {MAX_DRAWS} (default: {DEFAULT_DRAWS})",
        ),
    ),
)
