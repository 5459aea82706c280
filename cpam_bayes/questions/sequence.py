"""The question `sequence`: the probability of every stacking sequence on the grid."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Final

import numpy as np

from cpam_bayes.answer import Constant, FrequencyRow, Notice, Reliance
from cpam_bayes.command import EXECUTOR, TIME_LIMIT, WORKERS, Command, option, whole
from cpam_bayes.errors import checked
from cpam_bayes.formatting import decimals_of, fixed, probable, significant
from cpam_bayes.forward_model.known_errors import ScaleError, absorbed
from cpam_bayes.forward_model.model import air_shifts, with_references
from cpam_bayes.forward_model.preconditions import (
    count_slips,
    exchange_notices,
    explained_failures,
    misfit_over_noise,
    misfit_slips,
    reference_contradictions,
    reference_slips,
    require_reachable,
    require_seed,
    require_sequence,
    require_whole,
    stated_slips,
)
from cpam_bayes.identification.point import reliances, verdict_of
from cpam_bayes.parallel import open_executor
from cpam_bayes.plate import PlateLike, Specimen, read_plate, to_user, user_name
from cpam_bayes.printed.tables import identified_layups
from cpam_bayes.questions.identify.slips import bound_slips, pushed
from cpam_bayes.render.plate import plate_section
from cpam_bayes.render.report import (
    COMPUTATION,
    Report,
    Rows,
    Section,
    Table,
    facts,
    plate_keys,
    remarks,
)
from cpam_bayes.render.sentences import (
    basis_error_text,
    bounds_step,
    constant_rows,
    constants_table,
    errors_table,
    fit_sentence,
    intervals_sentence,
    mismatch_step,
    plate_argument,
    references_said,
    reliance_sentences,
    residual_columns,
)
from cpam_bayes.render.stacking import (
    FIRST_SCREEN,
    SEQUENCES,
    ListedSequence,
    angle_table,
    angles_text,
    constants_by_name,
    drawings,
    mixture_table,
    outer_and_inner,
    same_bending,
)
from cpam_bayes.result import PlateResult, present, within_time
from cpam_bayes.running import SILENT, Watch, time_limit
from cpam_bayes.stacking.notices import stacking_notices
from cpam_bayes.stacking.posterior import (
    StackingMixture,
    inference_data,
    model_of,
    n_sampled_classes,
    sample_mixture,
    stacking_posterior,
    sums_of,
    with_angles,
)
from cpam_bayes.stacking.queries import (
    AngleInformation,
    BestFit,
    GivenLayup,
    angle_information,
    best_fit,
    given_layup,
)
from cpam_bayes.stacking.records import DEFAULT_SETTINGS, StackingPosterior

# Steps of the progress display.
_PIECES = 64
# Largest number of listed sequences.
MAX_LISTED = 2000


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class StackingResult(PlateResult):
    """The posterior over stacking sequences, the constants marginalised.

    Attributes
    ----------
    answer : the most probable sequences with their probabilities, marginals of the angles, sums
    mixture : draws of the constants over all sequences, errors of sizes, mass and frequency scale included
    given : the paper's sequence for a built-in specimen, None for other plates
    fit : the most probable sequence beside the measured frequencies
    information : what the frequencies tell about each ply
    explained : whether the stated noise explains the residuals of the most probable sequence
    scale_errors : effect of errors of sizes, mass and frequency scale on the constants
    constants : averaged over all sequences
    reliances : intervals that depend on the bounds or the prior of another constant
    top : number of sequences in the JSON document
    """

    command: ClassVar[str] = "sequence"

    answer: StackingPosterior
    mixture: StackingMixture
    given: GivenLayup | None
    fit: BestFit
    information: AngleInformation
    explained: bool
    scale_errors: tuple[ScaleError, ...]
    constants: tuple[Constant, ...]
    reliances: tuple[Reliance, ...]
    top: int

    @property
    def has_draws(self) -> bool:
        """True: the answer always has draws."""
        return True

    def to_arviz(self) -> Any:
        """The draws with their log densities for arviz, as in ``posterior.nc``."""
        return inference_data(self.answer, self.mixture, self.command, self.seed)

    @property
    def status(self) -> str:
        """Either "converged", where all chains of the constants have, or "not converged"."""
        return "converged" if self.mixture.converged else "not converged"

    @property
    def most_probable(self) -> Specimen:
        """The specimen with the most probable angles."""
        return _most_probable(self.answer)


@checked
@within_time
def sequence(
    plate: PlateLike,
    *,
    seed: int = 0,
    top: int = 100,
    executor: str = "serial",
    workers: int | None = None,
    watch: Watch = SILENT,
) -> StackingResult:
    """The posterior over every stacking sequence on the grid of the unknown angles, with equal priors.

    Parameters
    ----------
    plate : a built-in name, a path, a table or a `Specimen`, see `read_plate`, with "?" in its
        layup; built-in specimens take the unknown angles of Table 9(b)
    top : number of most probable sequences to list
    executor, workers : "serial", in this process; "processes", as many as cores or ``workers``, which needs
        the call to stand under ``if __name__ == "__main__":`` in a script; or a Dask cluster, see
        `cpam_bayes.parallel.open_executor`. The answer is the same
    watch : progress display; none if left out

    Raises
    ------
    ValueError
        If the plate cannot be read, has no unknown angle, no measured frequencies or no unknowns.

    Examples
    --------
    >>> import cpam_bayes as cb
    >>> plate = {
    ...     "name": "two unknown angles",
    ...     "plate": {
    ...         "length_mm": 260, "width_mm": 190, "thickness_mm": 3.2,
    ...         "density_kg_m3": 1590, "layup": "[?/?]_s", "edges": "FFFF",
    ...     },
    ...     "material": {
    ...         "isotropic": False, "E1_GPa": 121.2, "E2_GPa": 9.34, "nu12": 0.23, "G12_GPa": 6.25,
    ...     },
    ...     "unknowns": {
    ...         "E1_GPa": [80, 160], "E2_GPa": [5, 20], "nu12": [0.15, 0.4], "G12_GPa": [4, 10],
    ...         "angle_grid_deg": 30,
    ...     },
    ...     "measurement": {
    ...         "frequencies_hz": [154.4, 286.9, 402.8, 414.4, 574.5, 749.3], "relative_std": 0.01,
    ...     },
    ... }
    >>> result = cb.sequence(plate, executor="serial")
    >>> result.answer.top[0].tolist(), int(result.answer.multiplicity[0])
    ([-30.0, 60.0], 2)
    """
    require_seed(seed)
    require_whole("top", top, 1, MAX_LISTED)
    specimen = require_sequence(read_plate(plate).with_unknown_angles())
    require_reachable(specimen)
    specimen = with_references(specimen)
    settings = replace(DEFAULT_SETTINGS, listed=max(DEFAULT_SETTINGS.listed, top))
    sums_of(specimen, settings)  # what cannot be enumerated is refused at once
    with open_executor(executor, workers) as pool:
        with (
            explained_failures(specimen),
            watch.stage(f"sequence {specimen.name}", _PIECES, counted="pieces of the work") as shown,
        ):
            answer = stacking_posterior(
                specimen,
                seed,
                settings=settings,
                executor=pool,
                notify=shown.notify,
                progress=lambda done, _: shown.tick(done, float(done)),
            )
        with time_limit(None):  # one sequence, even if time is up
            given = _printed(answer)
        classes = n_sampled_classes(answer) + (given is not None)
        with watch.stage("constants by emcee", classes, counted="layups") as shown:
            mixture = sample_mixture(
                answer,
                seed,
                given=given,
                executor=pool,
                progress=lambda done, _: shown.tick(done, float(done)),
            )
    with time_limit(None):
        return stacking_result(answer, mixture, given, seed, top)


def stacking_result(
    answer: StackingPosterior, mixture: StackingMixture, given: GivenLayup | None, seed: int, top: int
) -> StackingResult:
    """The result of `sequence`: the posterior with fit, constants, information by ply, and notices."""
    specimen, fit = answer.specimen, best_fit(answer)
    measurement, layup, unknowns = (
        answer.conditional.template.measurement,
        _most_probable(answer),
        specimen.unknowns,
    )
    listed = np.flatnonzero(fit.mode >= 0)
    taken_up = absorbed(
        layup,
        model_of(layup, answer.conditional.model),
        {name: fit.constants[name] for name in unknowns.names},
        fit.mode[listed],
        {name: unknowns[name].prior.sd for name in unknowns.names},
        listed,
    )
    explained = misfit_over_noise(measurement, fit.residual, specimen.unknowns.size) == 1.0
    reliances = _reliances(answer, mixture)
    constants = _constants(answer, mixture, reliances, explained=explained)
    return StackingResult(
        seed=seed,
        notices=(
            *_slips(specimen, fit, constants, explained=explained),
            *stacking_notices(answer, mixture, fit),
            *exchange_notices(specimen),
        ),
        reached_goal=mixture.converged,
        specimen=specimen,
        air_shifts=air_shifts(layup),
        answer=answer,
        mixture=mixture,
        given=given,
        fit=fit,
        information=angle_information(specimen.plate.layup, answer.marginals),
        explained=explained,
        scale_errors=taken_up.errors(usual=True),
        constants=constants,
        reliances=reliances,
        top=top,
    )


def _reliances(answer: StackingPosterior, mixture: StackingMixture) -> tuple[Reliance, ...]:
    """Reliances among the constants over all sequences."""
    parameters, names = answer.conditional.parameters, answer.specimen.unknowns.names
    covariance = np.atleast_2d(np.cov(mixture.parameters[:, : len(names)].T))
    return reliances(names, covariance, np.array([parameters[name].prior.sd for name in names]))


def _slips(
    specimen: Specimen, fit: BestFit, constants: tuple[Constant, ...], *, explained: bool
) -> tuple[Notice, ...]:
    residual = np.asarray(fit.residual)[np.isfinite(fit.residual)]
    misfit = float(np.sqrt(np.mean(residual**2))) if residual.size else 0.0
    measurement = specimen.measurement
    assert measurement is not None
    return (
        *stated_slips(specimen),
        *count_slips(measurement.size, specimen.unknowns.size),
        *bound_slips(constants),
        *(reference_contradictions(specimen, {}, constants) if explained else ()),
        *misfit_slips(misfit),
        *reference_slips(specimen),
    )


def _printed(answer: StackingPosterior) -> GivenLayup | None:
    """The printed layup of Table 9(b), if the specimen is built in."""
    name = answer.specimen.name
    printed = identified_layups().get(name)
    if printed is None or answer.specimen.source != f"built-in {name}":
        return None
    return given_layup(answer, np.array(printed.angles_deg, dtype=float))


def _most_probable(answer: StackingPosterior) -> Specimen:
    return with_angles(answer.specimen, answer.top[0])


# Sequences on the first screen, and in the table behind it.
_SHOWN: Final = 10
_LISTED: Final = 30
# Probability of the first sequence and its equals above which the layup counts as determined.
_SURE: Final = 0.95


@present.register
def _present(result: StackingResult) -> Report:
    answer, mixture, given = result.answer, result.mixture, result.given
    every = tuple(ListedSequence(answer, mixture, i) for i in range(min(result.top, len(answer.top))))
    sequences = Rows("sequences", SEQUENCES, every)
    frequencies = _frequencies(result)
    constants = result.constants
    told = tuple(c.name for c in constants if not c.is_open)
    errors = result.scale_errors
    return Report(
        summary=result.screen(
            headline=_headline(result, every[0]),
            tables=(
                constants_table(constants),
                Rows("sequences", FIRST_SCREEN, every[:_SHOWN]).table("Most probable layups"),
            ),
            lines=(
                _credible(answer),
                _fit(result),
                _OF_NO_LAYUP
                if _contradicted(result)
                else intervals_sentence(
                    result.specimen.plate,
                    errors,
                    told,
                    also=("all sequences", *references_said(result.specimen)),
                ),
            ),
            next_step=_next_step(result, every[0]),
        ),
        sections=(
            plate_section(result.specimen, result.air_shifts),
            Section(
                "Stacking sequences",
                (Rows("sequences", SEQUENCES, every[:_LISTED]).table("Most probable stacking sequences"),),
                ("credible_set",),
                folded=False,
            ),
            Section(
                "Angle by angle",
                (
                    angle_table(answer, result.information),
                    remarks("Outer and inner plies", (outer_and_inner(result.information),)),
                ),
                ("angles",),
                folded=False,
            ),
            Section(
                "Measured frequencies and the most probable sequence",
                (
                    frequencies.table("Measured frequencies and the most probable sequence"),
                    _missed(result),
                ),
            ),
            Section(
                "Constants over all sequences",
                (
                    mixture_table(answer, mixture, given),
                    remarks("Influential bounds and priors", _reliance(result, told)),
                    errors_table(errors, told),
                ),
                ("constants",),
            ),
            Section(COMPUTATION, (facts("All stacking sequences", tuple(_work(result))),)),
        ),
        document=_document(result, sequences, frequencies),
        drawings=drawings(answer, mixture, given),
        rows=(sequences, constant_rows(constants), frequencies),
    )


_OF_NO_LAYUP: Final = "The constants are those of a layup that does not fit: do not use them."


def _contradicted(result: StackingResult) -> bool:
    """Whether no layup on the grid explains the frequencies."""
    return any(notice.code in ("no_sequence_explains", "sequence_noise") for notice in result.notices)


def _headline(result: StackingResult, first: ListedSequence) -> str:
    """The most probable layup with its probability, unless none explains the frequencies."""
    equal = int(first.answer.multiplicity[first.i]) - 1
    other = "another layup" if equal == 1 else f"one of {equal} layups"
    others = f", or {other} with the same frequencies" if equal else ""
    if _contradicted(result):
        return f"No layup on the grid explains the frequencies; the most probable is {first.angles}{others}."
    if first.together >= _SURE:
        return f"Probability {first.together:.3g}: the unknown angles are {first.angles}{others}."
    return (
        f"Probability {probable(float(f'{first.together:.2g}'))}: the unknown angles are most likely "
        f"{first.angles}{others}; the frequencies do not determine them."
    )


def _credible(answer: StackingPosterior) -> str:
    verb = "holds" if answer.credible_count == 1 else "hold"
    return (
        f"On the {answer.specimen.angle_grid_deg:g}-degree grid {answer.credible_count} of "
        f"{answer.enumerated} layups {verb} 95 % of the probability."
    )


def _fit(result: StackingResult) -> str:
    residual = np.asarray(result.fit.residual)[np.isfinite(result.fit.residual)]
    if not residual.size:
        return "No frequency is paired with a mode."
    rms, noise = float(np.sqrt(np.mean(residual**2))), result.fit.noise
    if result.answer.conditional.template.noise_is_inferred:
        return fit_sentence(rms, inferred=noise)
    measurement = result.specimen.measurement
    return fit_sentence(rms, stated=noise, measurement=measurement, explained=result.explained)


def _next_step(result: StackingResult, first: ListedSequence) -> str:
    for step in (*bounds_step(result.notices), *mismatch_step(result.specimen, result.notices)):
        return step
    if any(notice.code == "few_frequencies" for notice in result.notices):
        return "measure more modes: bounds and the grid of angles decide this layup."
    if first.together < _SURE:
        return 'write known angles instead of "?", bound the constants, or measure more modes.'
    return (
        "write these angles into the layup; is anything wrong with the plate or the list?  cpam-bayes "
        f"diagnose {plate_argument(result.specimen)}"
    )


def _constants(
    answer: StackingPosterior, mixture: StackingMixture, relied_on: tuple[Reliance, ...], *, explained: bool
) -> tuple[Constant, ...]:
    """The constants averaged over all sequences; explained : as in `StackingResult`."""
    parameters, draws = answer.conditional.parameters, mixture.parameters
    reference, constants = answer.specimen.material.constants, []
    for i, name in enumerate(answer.specimen.unknowns.names):
        low, high = np.quantile(draws[:, i], (0.025, 0.975))
        prior, sd = parameters[name].prior, float(draws[:, i].std())
        constant = pushed(
            Constant(
                name=name,
                value=float(draws[:, i].mean()),
                sd=sd,
                interval=(float(low), float(high)),
                prior=prior,
                reference=float(reference.get(name, np.nan)),
                verdict=verdict_of(sd, prior.sd, explained=explained),
                rests_on=tuple(r.on for r in relied_on if r.name == name),
                has_former_plate=parameters[name].coupled is not None,
            )
        )
        constants.append(constant)
    return tuple(constants)


def _reliance(result: StackingResult, told: Sequence[str]) -> tuple[str, ...]:
    parameters = result.answer.conditional.parameters
    return reliance_sentences(result.reliances, lambda name: parameters[name].prior, told)


def _frequencies(result: StackingResult) -> Rows:
    measured = result.answer.conditional.template.measurement.frequencies
    rows = tuple(
        FrequencyRow(float(f), None if np.isnan(p) else float(p))
        for f, p in zip(measured, result.fit.predicted, strict=True)
    )
    return Rows("frequencies", residual_columns(rows), rows)


def _missed(result: StackingResult) -> Table:
    decimals = decimals_of(result.answer.conditional.template.measurement.frequencies)
    lacks = ", ".join(fixed(float(f), decimals + 1) for f in result.fit.missed)
    said = (f"modes of the most probable sequence at {lacks} Hz",) if lacks else ()
    return remarks("Missing from the measured frequencies", said)


def _work(result: StackingResult) -> list[tuple[str, str]]:
    answer, mixture, check, given = result.answer, result.mixture, result.answer.check, result.given
    rows = [
        (
            "sequences",
            f"{answer.enumerated} on the grid of {answer.specimen.angle_grid_deg:g} degrees, all equally "
            "probable before the measurement",
        ),
        ("layup", answer.specimen.plate.layup.text),
        ("noise", _noise(result)),
        ("symmetries", ", ".join(s.name for s in answer.symmetries) or "none"),
        *same_bending(answer),
    ]
    if given is not None:
        place = f"number {given.rank}" if given.rank else f"not among the first {len(answer.top)}"
        rows.append(
            ("printed", f"{angles_text(given.angles_deg)}: probability {given.probability:.3g}, {place}")
        )
    rows += [
        ("95 % set", f"{answer.credible_count} sequence" + ("s" if answer.credible_count > 1 else "")),
        ("effective number", f"{significant(answer.effective_count, 3)} sequences, exp of the entropy"),
        ("left out", f"{answer.unaccounted:.1g} of the probability at most"),
        (
            "constants",
            f"emcee on the first {len(mixture.components)} of the list, "
            f"{100 * mixture.emcee_fraction:.1f} % of the probability; importance sampling on the rest",
        ),
    ]
    if check is not None:
        rows.append(
            (
                "surrogate",
                f"trained on {check.training_size} sequences; log evidence off by {check.rms:.2f} (rms), "
                f"{check.largest:.2f} (most) on draws from the result, which correct its sum",
            )
        )
    rows.append(("reduced basis", basis_error_text(answer.basis_error)))
    took = f"{answer.seconds:.0f} s and {mixture.seconds:.0f} s for the constants, seed {result.seed}"
    return [*rows, ("work", took)]


def _noise(result: StackingResult) -> str:
    """The noise assumed by the probabilities, and how well the first sequence fits within it."""
    level = f"{significant(100 * result.fit.noise, 2)} % of a frequency"
    if result.answer.conditional.template.noise_is_inferred:
        return f"{level}, inferred, given the most probable sequence"
    said = f"{level}, from the plate file"
    if result.fit.p_value is None:
        return said
    return f"{said}; alone it gives residuals this large with probability {result.fit.p_value:.2g}"


def _document(result: StackingResult, sequences: Rows, frequencies: Rows) -> dict[str, Any]:
    answer, mixture, check = result.answer, result.mixture, result.answer.check
    information, fit = result.information, result.fit
    return {
        **plate_keys(result.command, result.seed, result.specimen),
        "enumerated": answer.enumerated,
        "classes": answer.classes,
        "symmetries": [s.name for s in answer.symmetries],
        "angle_grid_deg": answer.grid_deg.tolist(),
        "log_evidence": answer.log_evidence_total,
        "sequences": sequences.records(),
        "credible_95_count": answer.credible_count,
        "effective_count": answer.effective_count,
        "unaccounted_probability": answer.unaccounted,
        "angle_marginals": answer.marginals.tolist(),
        "angle_entropy_bits": np.abs(information.entropy_bits).tolist(),
        "angle_entropy_most_bits": information.most_bits,
        "outer_plies_better_determined": information.outer_better,
        "constants": _constant_keys(answer, mixture),
        "mixture": {
            "draws": len(mixture.parameters),
            "sampled_by_emcee": len(mixture.components),
            "probability_by_emcee": mixture.emcee_fraction,
            "probability_by_importance_sampling": mixture.listed_fraction,
            "probability_by_drawn_sequences": mixture.drawn_fraction,
            "converged": mixture.converged,
            "worst_difference_in_standard_errors": max((c.worst_z for c in mixture.sampled), default=None),
            "seconds": mixture.seconds,
        },
        "frequencies": frequencies.records(),
        "missed_modes": [{"predicted_hz": float(f)} for f in fit.missed],
        "p_value": fit.p_value,
        "noise_percent": 100.0 * fit.noise,
        "noise_inferred": answer.conditional.template.noise_is_inferred,
        "printed_sequence": None if result.given is None else _printed_keys(answer, mixture, result.given),
        "learned": None
        if check is None
        else {
            "from_sequences": check.training_size,
            "rms_error_nats": check.rms,
            "largest_error_nats": check.largest,
            "overlooked_nats": check.overlooked,
            "correction_nats": check.correction,
            "effective_share": check.effective,
        },
        "basis_error": answer.basis_error,
        "seconds": answer.seconds,
        "warnings": list(result.warnings),
        "notes": list(result.specimen.notes),
    }


def _constant_keys(answer: StackingPosterior, mixture: StackingMixture) -> dict[str, dict[str, float]]:
    """Mean, sd and quantiles of the constants over the draws of the mixture."""
    constants = {}
    for i, name in enumerate(answer.specimen.unknowns.names):
        x = mixture.parameters[:, i] * to_user(name, 1.0)
        q025, q975 = np.quantile(x, (0.025, 0.975))
        constants[user_name(name)] = {
            "mean": float(x.mean()),
            "sd": float(x.std()),
            "q025": float(q025),
            "q975": float(q975),
        }
    return constants


def _printed_keys(answer: StackingPosterior, mixture: StackingMixture, given: GivenLayup) -> dict[str, Any]:
    chains = None if mixture.given is None else mixture.given.chains
    return {
        "angles_deg": given.angles_deg.tolist(),
        "probability": given.probability,
        "rank": given.rank,
        "log_evidence": given.log_evidence,
        "log_evidence_error": given.log_evidence_error,
        "k_hat": given.k_hat,
        "constants": None if chains is None else constants_by_name(answer, chains.mean),
        "constants_sd": None if chains is None else constants_by_name(answer, chains.sd),
    }


COMMAND: Final = Command(
    sequence,
    (
        option(
            "plate",
            metavar="PLATE",
            help='built-in specimen, with the unknown angles of Table 9(b), or path of a plate file with "?" '
            "in its layup",
        ),
        option(
            "--top",
            type=whole(1, MAX_LISTED),
            default=100,
            metavar="N",
            help=f"most probable sequences in the JSON document, 1 to {MAX_LISTED}, of which the screen "
            f"shows the first {_SHOWN} (default: 100)",
        ),
        EXECUTOR,
        WORKERS,
        TIME_LIMIT,
    ),
)
