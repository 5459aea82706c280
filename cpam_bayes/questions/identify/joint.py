"""Joint identification: constants shared by tests of one plate or plates of one material, `identify A B`."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any, ClassVar, Final

import numpy as np

from cpam_bayes import __version__
from cpam_bayes.answer import Constant, FrequencyRow, Notice
from cpam_bayes.diagnosis.comparison import SCATTER
from cpam_bayes.formatting import listed, significant
from cpam_bayes.forward_model.model import with_references
from cpam_bayes.forward_model.preconditions import (
    LARGE_ERROR,
    error_notices,
    explained_failures,
    high_noise_notices,
    misfit_slips,
    require_number,
    require_paired_list,
    require_supported,
    stated_slips,
)
from cpam_bayes.forward_model.three_dimensions import sandwich_notices
from cpam_bayes.identification.joint import (
    JointEstimate,
    ListFit,
    estimate_jointly,
    prior_notices,
    require_joint,
)
from cpam_bayes.identification.search import NO_MESH, required
from cpam_bayes.inference.swarm import SwarmSettings
from cpam_bayes.plate import PlateLike, read_plate, to_user, user_name
from cpam_bayes.questions.identify.slips import (
    GROSS,
    Slip,
    bound_slips,
    corrected_texts,
    pushed,
    slip_records,
    slips_where_unreachable,
    with_slips,
)
from cpam_bayes.render.figures import PREDICTED, new_figure
from cpam_bayes.render.report import (
    COMPUTATION,
    Caption,
    Column,
    Drawing,
    Report,
    Rows,
    Section,
    facts,
    laminate_keys,
)
from cpam_bayes.render.sentences import (
    constant_details,
    constant_keys,
    constant_rows,
    constants_headline,
    constants_table,
    correction_step,
    frequency_columns,
    further_steps,
    mismatch_step,
    more_modes_step,
    plate_argument,
    references_said,
    reliance_table,
)
from cpam_bayes.result import PlatesResult, present
from cpam_bayes.running import Watch

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MAX_SCATTER: Final = 0.5


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class JointResult(PlatesResult):
    """The constants shared by several lists.

    Attributes
    ----------
    estimate : constants, and the fit of every list
    explained_by : for each plate, slips of its file that explain its misfit, the most probable first
    """

    command: ClassVar[str] = "identify"

    estimate: JointEstimate
    explained_by: tuple[tuple[Slip, ...], ...]

    @property
    def constants(self) -> Mapping[str, Constant]:
        """Name -> constant in SI, Pa or dimensionless; `to_dict` and `to_dataframe` have plate-file units."""
        return {c.name: c for c in self.estimate.constants}

    @property
    def frequencies(self) -> tuple[FrequencyRow, ...]:
        """Measured and predicted frequencies of all lists, Hz, one row each."""
        return tuple(row for fit in self.estimate.fits for row in _rows(fit))

    def texts(self) -> Mapping[str, str]:
        """Corrected plate files, without the slips that explain the misfit, numbered as the plates."""
        each = enumerate(zip(self.plates, self.explained_by, strict=True), 1)
        files = (corrected_texts(plate, slips, f"corrected_{i}.toml") for i, (plate, slips) in each)
        return {name: text for file in files for name, text in file.items()}


def identify_jointly(
    plates: Sequence[PlateLike],
    seed: int,
    swarms: int,
    settings: SwarmSettings,
    scatter: float | None,
    watch: Watch,
) -> JointResult:
    """Joint identification of several plates, see `identify`."""
    scatter = SCATTER if scatter is None else scatter
    require_number("scatter", scatter, MAX_SCATTER)
    specimens = tuple(require_paired_list(require_supported(read_plate(p), NO_MESH)) for p in plates)
    for specimen in specimens:
        required(specimen)
    known = [slips_where_unreachable(specimen) for specimen in specimens]
    require_joint(specimens)
    title = f"identify {' '.join(specimen.name for specimen in specimens)}"
    with (
        explained_failures(specimens[0]),
        watch.stage(title, len(specimens) * swarms * settings.iterations) as shown,
    ):
        estimate = estimate_jointly(
            specimens,
            seed,
            scatter=scatter,
            swarms=swarms,
            settings=settings,
            progress=shown.tick,
            notify=shown.notify,
        )
    estimate = replace(estimate, constants=tuple(map(pushed, estimate.constants)))
    # no slips are tried for a list that fits by itself
    tried = [
        with_slips(_excess(fit), with_references(of), fit.alone, watch.announce, slips)
        for fit, of, slips in zip(estimate.fits, specimens, known, strict=True)
    ]
    slips = tuple(found for _, found in tried)
    excess = [(fit, notices) for fit, (notices, _) in zip(estimate.fits, tried, strict=True)]
    if any(slips):  # the lists that fit alone misfit because of these
        excess = [(fit, notices) for fit, notices in excess if fit.alone > GROSS]
    return JointResult(
        seed=seed,
        notices=(
            *(slip for fit in estimate.fits for slip in _of_list(fit, stated_slips(fit.specimen))),
            *(notice for _, notices in excess for notice in notices),
            *bound_slips(estimate.constants),
            *prior_notices(specimens),
            *_notices(estimate),
        ),
        plates=specimens,
        estimate=estimate,
        explained_by=slips,
    )


def _excess(fit: ListFit) -> tuple[Notice, ...]:
    if fit.noise_is_inferred:
        return _of_list(fit, misfit_slips(fit.noise))
    return _of_list(
        fit, [Notice("list_over_noise", "slip", {"times": fit.misfit})] if fit.misfit > 1.0 else []
    )


def _of_list(fit: ListFit, notices: Iterable[Notice]) -> tuple[Notice, ...]:
    return tuple(replace(n, facts={**n.facts, "plate": fit.specimen.name}) for n in notices)


def _notices(estimate: JointEstimate) -> tuple[Notice, ...]:
    """Reasons to distrust the constants: noise too high for a tap test, solver error, soft cores."""
    found: list[Notice] = []
    constants = {c.name: c.value for c in estimate.constants}
    for fit in estimate.fits:
        if fit.noise_is_inferred and not misfit_slips(fit.noise):
            found += _of_list(fit, high_noise_notices(fit.noise))
        found += error_notices(fit.error, LARGE_ERROR)
        found += sandwich_notices(fit.specimen, fit.predicted, constants)
    return tuple(found)


def _contradictions(result: JointResult) -> tuple[str, ...]:
    """Next step for the first plate file that contradicts itself, empty if none does."""
    each = (mismatch_step(plate, stated_slips(plate)) for plate in result.plates)
    return next((step for step in each if step), ())


def _rows(fit: ListFit) -> tuple[FrequencyRow, ...]:
    each = zip(fit.measurement.frequencies.tolist(), fit.predicted, strict=True)
    return tuple(
        FrequencyRow(f, mode.frequency, mode.kind, mode.label, i, plate=fit.specimen.name)
        for i, (f, mode) in enumerate(each, 1)
    )


_FIT: Final = (
    Column("list", "plate", lambda fit: fit.specimen.name),
    Column("specimen", "specimen", lambda fit: fit.specimen.specimen),
    Column("edges", "edges", lambda fit: fit.specimen.plate.edges),
    Column("frequencies", "n_frequencies", lambda fit: fit.measurement.size, number=True),
    Column("fit %", "rms_percent", lambda fit: 100.0 * fit.rms, lambda v: significant(v, 2), True),
    Column("noise %", "noise_percent", lambda fit: 100.0 * fit.noise, lambda v: significant(v, 2), True),
    Column("", "noise_source", lambda fit: "residuals" if fit.noise_is_inferred else "plate file"),
)


@present.register
def _present(result: JointResult) -> Report:
    estimate = result.estimate
    constants, fits = estimate.constants, Rows("lists", _FIT, estimate.fits, lambda fit: fit.misfit > 1.0)
    rows = result.frequencies
    of_plate = Column("list", "plate", lambda row: row.plate)
    frequencies = Rows("frequencies", (of_plate, *frequency_columns(rows)), rows)
    use = [c.name for c in constants if not c.is_open]
    plates = " ".join(plate_argument(specimen) for specimen in result.plates)
    wrong = [plate.name for plate, slips in zip(result.plates, result.explained_by, strict=True) if slips]
    steps = (
        *_contradictions(result),
        *((correction_step(result.texts(), wrong),) if wrong else ()),
        f"is anything wrong with a plate or a list?  cpam-bayes diagnose {plates}",
    )
    return Report(
        summary=result.screen(
            headline=f"{_counted(estimate)}: {constants_headline(constants, len(rows))}",
            tables=(constants_table(constants), fits.table("Fit of each list")),
            lines=(_contained(result),),
            next_step=steps[0],
        ),
        sections=(
            Section(
                "Measured and predicted frequencies",
                (frequencies.table("Frequencies, residual = predicted / measured - 1"),),
                ("residuals",),
                folded=False,
            ),
            Section(
                "Constants",
                (
                    constant_details(constants, result.plates[0].material),
                    reliance_table(estimate.reliances, lambda n: result.constants[n].prior, use),
                ),
            ),
            further_steps((*steps[1:], *more_modes_step(constants))),
            Section(COMPUTATION, (_work(result),)),
        ),
        document=_document(result, fits, frequencies),
        drawings=(_residuals(result),),
        rows=(constant_rows(constants), frequencies, fits),
    )


def _counted(estimate: JointEstimate) -> str:
    tests, plates = len(estimate.fits), estimate.n_specimens
    if plates == 1:
        return f"one plate, {tests} tests"
    return f"{plates} plates" if plates == tests else f"{plates} plates, {tests} tests"


def _contained(result: JointResult) -> str:
    estimate, known = result.estimate, references_said(with_references(result.plates[0]))
    scatter = f"a scatter of {100.0 * estimate.scatter:.2g} % from plate to plate"
    also = (*known, *((scatter,) if estimate.n_specimens > 1 else ()))
    return f"The intervals contain {listed(['noise', 'sizes', 'mass', 'frequency scale', *also], 'and')}."


def _work(result: JointResult) -> Any:
    estimate = result.estimate
    n = len(estimate.optima)
    rows = (
        ("optima", f"{n} of the density of all lists together"),
        ("draws", f"{estimate.effective:.0f} equally probable ones by importance sampling"),
        ("work", f"{estimate.solves} forward solves in {estimate.seconds:.1f} s, seed {result.seed}"),
    )
    return facts("Search", rows)


def _document(result: JointResult, fits: Rows, frequencies: Rows) -> dict[str, Any]:
    estimate, names = result.estimate, list(result.constants)
    return {
        "command": result.command,
        "version": __version__,
        "seed": result.seed,
        "backend": "pso",
        "residuals": "whitened",
        "status": result.status,
        "tests": len(estimate.fits),
        "specimens": estimate.n_specimens,
        "scatter_percent": 100.0 * estimate.scatter if estimate.n_specimens > 1 else None,
        "constants": {user_name(c.name): constant_keys(c) for c in estimate.constants},
        "plates": [
            {
                **keys,
                "source": fit.specimen.source,
                "constants": {
                    user_name(name): to_user(name, value)
                    for name, value in zip(names, fit.constants.tolist(), strict=True)
                },
                "misfit_over_noise": fit.misfit,
                "explained_by": slip_records(slips),
                "relative_error_estimate": float(np.max(fit.error)),
                "laminate": laminate_keys(fit.laminate),
            }
            for keys, fit, slips in zip(fits.records(), estimate.fits, result.explained_by, strict=True)
        ],
        "frequencies": frequencies.records(),
        "optima": [
            {
                "constants": {user_name(n): to_user(n, v) for n, v in zip(names, x, strict=True)},
                "log_density": log_density,
            }
            for x, log_density in zip(estimate.optima.tolist(), estimate.log_density.tolist(), strict=True)
        ],
        "forward_solves": estimate.solves,
        "seconds": estimate.seconds,
        "warnings": list(result.warnings),
    }


def _residuals(result: JointResult) -> Drawing:
    return Drawing(
        "residuals",
        partial(_residuals_figure, result),
        Caption(
            "Difference of each frequency after the joint fit, list by list: above zero it is predicted too "
            "high, below too low.",
            f"Residuals of {len(result.frequencies)} modes of {len(result.plates)} lists in percent.",
        ),
    )


def _residuals_figure(result: JointResult) -> Figure:
    """The residuals of each list in a panel."""
    fits = result.estimate.fits
    figure = new_figure(5.8, 1.8 * len(fits) + 0.6)
    for axes, fit in zip(np.ravel(figure.subplots(len(fits), 1, sharey=True)), fits, strict=True):
        rows = _rows(fit)
        axes.axhline(0.0, color="0.5", linewidth=1)
        axes.bar(
            [row.number for row in rows],
            [100.0 * (row.residual or 0.0) for row in rows],
            0.5,
            color=PREDICTED,
        )
        axes.set(ylabel="residual, %")
        axes.set_title(f"{fit.specimen.name}: rms {100.0 * fit.rms:.2f} %", loc="left")
    return figure
