"""The question `calibrate`: coverage of the intervals of one plate and list, by simulated lists."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any, ClassVar, Final

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.calibration import (
    N_DRAWS,
    Coverage,
    Experiment,
    Nature,
    NatureSource,
    RankStatistics,
    Repetition,
    coverage,
    rank_statistics,
)
from cpam_bayes.calibration import calibrate as repeated
from cpam_bayes.command import EXECUTOR, PLATE, TIME_LIMIT, WORKERS, Command, option, whole
from cpam_bayes.errors import PlateFileError, checked
from cpam_bayes.formatting import listed
from cpam_bayes.forward_model.preconditions import (
    explained_failures,
    rectangular_only,
    require_seed,
    require_supported,
    require_whole,
)
from cpam_bayes.identification.search import posterior
from cpam_bayes.parallel import open_executor
from cpam_bayes.plate import PlateLike, Specimen, read_plate, user_name
from cpam_bayes.render.figures import new_figure
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
    plate_keys,
)
from cpam_bayes.render.sentences import plate_argument
from cpam_bayes.result import PlateResult, present, within_time
from cpam_bayes.running import SILENT, Watch

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_MOST_LISTS: Final = 10_000
# Bins of the rank histogram; p-value below which ranks are not uniform.
_BINS, _DOUBTFUL = 20, 0.01


@dataclass(frozen=True, slots=True)
class CalibratedConstant:
    """Coverage and ranks of one parameter over all simulated lists.

    name : as in [unknowns], or of the noise
    coverage : of the central 50, 80 and 95 % intervals
    counts : (20,) histogram of the rank of the true value among its posterior draws
    p_value : for uniform ranks, corrected for the number of parameters (Holm)
    """

    name: str
    coverage: tuple[Coverage, ...]
    counts: tuple[int, ...]
    p_value: float

    @property
    def widest(self) -> Coverage:
        """Coverage of the 95 % intervals."""
        return self.coverage[-1]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class CalibrationResult(PlateResult):
    """Coverage and ranks over lists simulated for one plate.

    Attributes
    ----------
    repetitions : one for each list
    constants : varying parameters, the noise last where it is inferred
    band : simultaneous 95 % band of the rank counts under uniform ranks
    """

    command: ClassVar[str] = "calibrate"

    repetitions: tuple[Repetition, ...]
    constants: tuple[CalibratedConstant, ...]
    band: tuple[tuple[int, int], ...]


@checked
@within_time
def calibrate(
    plate: PlateLike,
    n: int = 100,
    *,
    seed: int = 0,
    executor: str = "serial",
    workers: int | None = None,
    watch: Watch = SILENT,
) -> CalibrationResult:
    """Simulation-based calibration of a plate and its list (Talts et al., 2018).

    Constants, sizes and noise are drawn from their priors; a list with the plate's number of frequencies is
    simulated at them and sampled like a measured one. Over many lists the rank of the true value among the
    draws of its posterior is then uniform. This checks priors, likelihood and sampler, not the plate
    model, which is taken as true.

    Parameters
    ----------
    plate : a built-in name, a path, a table or a `Specimen`, see `read_plate`
    n : number of lists, 20 to 10000
    executor, workers : as for `cb.sequence`
    watch : progress display; none if left out

    Raises
    ------
    ValueError
        If the plate cannot be read, or has no unknowns or no list.

    Examples
    --------
    >>> import cpam_bayes as cb
    >>> result = cb.calibrate("A1", 20, seed=1)
    >>> [c.name for c in result.constants], result.constants[0].widest.level
    (['E1_GPa', 'nu12', 'relative_std'], 0.95)
    """
    require_seed(seed)
    require_whole("n", n, 20, _MOST_LISTS)
    specimen = _plain_list(require_supported(read_plate(plate), rectangular_only("calibrate")))
    measurement = specimen.measurement
    assert measurement is not None
    with (
        watch.stage(f"calibrate {specimen.name}", n, counted="lists") as shown,
        open_executor(executor, workers) as pool,
        explained_failures(specimen),
    ):
        density = posterior(specimen)
        nature = Nature(density.model, density.noise_model.solver_error)
        done = 0

        def count(_: Repetition) -> None:
            nonlocal done
            done += 1
            shown.tick(done, float(n - done))

        experiment = Experiment(
            NatureSource(nature),
            measurement.resolution,
            measurement.relative_std,
            seed,
            n_listed=measurement.size,
        )
        repetitions = repeated(experiment, n, executor=pool, on_result=count)
    names = density.parameters.names
    # sizes and frequency scale are drawn too, but their coverage is not reported
    kept = [i for i, name in enumerate(names) if name in (*specimen.unknowns.names, density.noise_name)]
    ranks = np.array([r.ranks for r in repetitions])[:, kept]
    below = np.array([r.below for r in repetitions])[:, kept]
    statistics = rank_statistics(ranks, N_DRAWS + 1, np.random.default_rng(seed), n_bins=_BINS)
    band = statistics.histogram_band
    return CalibrationResult(
        seed=seed,
        specimen=specimen,
        repetitions=repetitions,
        constants=tuple(_constants([names[i] for i in kept], below, statistics)),
        band=tuple((int(a), int(b)) for a, b in zip(band.lower, band.upper, strict=True)),
    )


def _plain_list(specimen: Specimen) -> Specimen:
    """The specimen with a complete, unlabelled list, as simulated lists are."""
    measurement = specimen.measurement
    if measurement is None or not specimen.unknowns.size:
        raise PlateFileError(
            f"{specimen.source}: calibrate needs [unknowns], and a list in [measurement] for the number of "
            "modes and their repeatability"
        )
    if measurement.frequency_sd is not None:
        raise PlateFileError(
            f"{specimen.source}: measurement.frequency_sd_hz: calibrate takes one repeatability for all "
            "modes; state relative_std"
        )
    return replace(
        specimen,
        measurement=replace(measurement, labels=("",) * measurement.size, complete=True, shapes=None),
    )


def _constants(
    names: Sequence[str], below: NDArray[np.float64], statistics: RankStatistics
) -> list[CalibratedConstant]:
    """Coverage and ranks of n parameters; below : (lists, n) fractions of draws below the true value."""
    return [
        CalibratedConstant(
            user_name(name), coverage(below[:, i]), tuple(int(c) for c in own.counts), own.corrected_p
        )
        for i, (name, own) in enumerate(zip(names, statistics.parameters, strict=True))
    ]


def _share(level: int) -> Column:
    heading = f"in {(50, 80, 95)[level]} %"
    return Column(
        heading,
        None,
        lambda c: c.coverage[level],
        lambda found: f"{100 * found.share:.0f} +- {100 * found.standard_error:.0f} %",
        number=True,
    )


def _shown(name: str) -> str:
    """Parameter name without its unit; "noise" for the repeatability."""
    return "noise" if name == "relative_std" else name.partition("_")[0]


_COLUMNS: Final = (
    Column("", "name", lambda c: c.name, _shown),
    *(_share(level) for level in range(3)),
    Column(None, "coverage_95", lambda c: c.widest.share),
    Column(None, "standard_error", lambda c: c.widest.standard_error),
    Column("p of ranks", "p_value", lambda c: c.p_value, "{:.2f}".format, number=True),
)


@present.register
def _present(result: CalibrationResult) -> Report:
    rows = Rows("calibration", _COLUMNS, result.constants, lambda c: c.p_value < _DOUBTFUL)
    n = len(result.repetitions)
    converged = sum(r.converged for r in result.repetitions)
    least, most = (pick(100 * c.widest.share for c in result.constants) for pick in (min, max))
    doubtful = [_shown(c.name) for c in result.constants if c.p_value < _DOUBTFUL]
    return Report(
        summary=result.screen(
            headline=(
                f"The 95 % intervals held the true value in {least:.0f} to {most:.0f} % of {n} simulated "
                "lists."
            ),
            tables=(rows.table("True values inside their intervals"),),
            lines=(
                f"Ranks are not uniform for {listed(doubtful, 'and')}: do not rely on these intervals."
                if doubtful
                else "Ranks are uniform within chance.",
                "This checks priors, likelihood and sampler, not the plate model.",
                *((f"{n - converged} chains did not converge.",) if converged < n else ()),
            ),
            next_step=(
                "what are the plate's constants?  cpam-bayes identify "
                f"{plate_argument(result.specimen)} --backend emcee"
            ),
        ),
        sections=(
            plate_section(result.specimen, result.air_shifts),
            Section(
                COMPUTATION,
                (
                    facts(
                        "Lists",
                        (("simulated", str(n)), ("converged", str(converged)), ("seed", str(result.seed))),
                    ),
                ),
                ("ranks",),
                folded=False,
            ),
        ),
        document=_document(result),
        drawings=(
            Drawing(
                "ranks",
                partial(_draw_ranks, result),
                Caption(
                    "Ranks of the true values among draws of their posteriors. Bars within the grey band are "
                    "as expected; a peak in the middle shows intervals that are too wide, peaks at both ends "
                    "intervals that are too narrow, a slope a bias.",
                    f"Histograms of the ranks of {len(result.constants)} parameters over {n} lists.",
                ),
            ),
        ),
        rows=(rows,),
    )


def _document(result: CalibrationResult) -> dict[str, Any]:
    return {
        **plate_keys(result.command, result.seed, result.specimen),
        "lists": len(result.repetitions),
        "converged": sum(r.converged for r in result.repetitions),
        "constants": {
            c.name: {
                "coverage": [
                    {"level": x.level, "share": x.share, "standard_error": x.standard_error}
                    for x in c.coverage
                ],
                "rank_counts": list(c.counts),
                "p_value": c.p_value,
            }
            for c in result.constants
        },
        "rank_band": [list(pair) for pair in result.band],
        "warnings": list(result.warnings),
    }


def _draw_ranks(result: CalibrationResult) -> Figure:
    figure = new_figure(7.0, 1.9 * ((len(result.constants) + 2) // 3))
    panels = figure.subplots((len(result.constants) + 2) // 3, 3, squeeze=False).ravel()
    edges = np.linspace(0.0, 1.0, _BINS + 1)
    low, high = np.array(result.band).T
    for panel, constant in zip(panels, result.constants, strict=False):
        panel.stairs(high, edges, baseline=low, fill=True, color="0.85")
        panel.stairs(constant.counts, edges, color="#4878a8")
        panel.set(
            title=_shown(constant.name),
            xlim=(0.0, 1.0),
            ylim=(0.0, None),
            xlabel="rank of the true value",
        )
    for panel in panels[len(result.constants) :]:
        panel.set_visible(False)
    return figure


COMMAND: Final = Command(
    calibrate,
    (
        PLATE,
        option(
            "--lists",
            "n",
            type=whole(20, _MOST_LISTS),
            default=100,
            metavar="N",
            help=f"simulated lists, 20 to {_MOST_LISTS} (default: 100)",
        ),
        EXECUTOR,
        WORKERS,
        TIME_LIMIT,
    ),
)
