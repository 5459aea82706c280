"""The question `diagnose`: probabilities of errors of the plate, the list or the model."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import replace
from functools import partial
from typing import Final, Literal

import numpy as np

from cpam_bayes.answer import Constant, Notice, each_once
from cpam_bayes.command import EXECUTOR, PLATES, TIME_LIMIT, WORKERS, Command, option, positive
from cpam_bayes.diagnosis.cases import build_models, hypotheses_of, plate_case
from cpam_bayes.diagnosis.comparison import PlateCase
from cpam_bayes.diagnosis.diagnose import Diagnosis, diagnose_cases, diagnosis_notices
from cpam_bayes.diagnosis.evidence.marginal import distinct_hypotheses, prior_of
from cpam_bayes.diagnosis.evidence.sampled import ready
from cpam_bayes.diagnosis.extension import FrequencyRow, paired_fit, plain_mode_shapes
from cpam_bayes.diagnosis.fit import Fit, inferred_noise
from cpam_bayes.diagnosis.hypotheses import NONE, OTHER, P_NONE, P_SETS, SET, with_prior_of_none
from cpam_bayes.diagnosis.next_test import Candidate, next_measurements
from cpam_bayes.effects import CATALOGUE, Effect
from cpam_bayes.errors import checked
from cpam_bayes.formatting import decimals_of, fixed, signed, significant, with_spread
from cpam_bayes.forward_model.model import air_shifts
from cpam_bayes.forward_model.preconditions import (
    count_slips,
    equal_list_slips,
    explained_failures,
    misfit_slips,
    reference_slips,
    require_choice,
    require_diagnosable,
    require_number,
    require_reachable,
    require_seed,
    stated_slips,
)
from cpam_bayes.identification.joint import require_one_material
from cpam_bayes.parallel import open_executor
from cpam_bayes.plate import PlateLike, Specimen, read_plate, to_user, unit_of, user_name
from cpam_bayes.questions.diagnose.claim import (
    beyond_theory,
    checked_effects,
    headline,
    next_steps,
    sensitivity_sentence,
    shown_constants,
    stated_levels,
    summary,
)
from cpam_bayes.questions.diagnose.document import (
    FEW,
    DiagnosisResult,
    absorbed_biases,
    answer_constants,
    catalogue_sd,
    document,
    fit_constants,
    leading,
    probability_text,
    tables,
    taken_peaks,
    title_of,
    titles_of,
)
from cpam_bayes.questions.diagnose.drawings import drawings
from cpam_bayes.questions.identify.slips import bound_slips
from cpam_bayes.render.plate import air_text, plate_section
from cpam_bayes.render.report import (
    COMPUTATION,
    Column,
    Heading,
    Report,
    Rows,
    Section,
    Table,
    facts,
    remarks,
)
from cpam_bayes.render.sentences import (
    basis_error_text,
    further_steps,
    noise_word,
    reliance_sentences,
)
from cpam_bayes.render.spectrum import peak_sections
from cpam_bayes.result import present, within_time
from cpam_bayes.running import SILENT, Watch, cut_short, is_time_up

__all__ = ["COMMAND", "DiagnosisResult", "diagnose", "diagnosis_result"]

DEFAULT_SCATTER: Final = 0.02
MAX_SCATTER: Final = 0.5
MAX_PRIOR_NONE: Final = 0.99
MAX_PLATES: Final = 50


@checked
@within_time
def diagnose(
    *plates: PlateLike,
    seed: int = 0,
    scatter: float = DEFAULT_SCATTER,
    prior_none: float | None = None,
    next_test: Literal["open", "always", "never"] = "open",
    catalogue: tuple[Effect, ...] | None = None,
    executor: str = "serial",
    workers: int | None = None,
    watch: Watch = SILENT,
) -> DiagnosisResult:
    """Probabilities of errors of the plate, the list or the model, and constants that allow for them.

    Parameters
    ----------
    plates : each a built-in name, a path, a table or a `Specimen`, see `read_plate`;
        several plates share one material and its constants; those with equal ``specimen`` are one
        plate under several tests
    scatter : relative standard deviation of a constant from plate to plate of one material
    prior_none : prior probability that nothing is wrong, 0.5 if left out
    next_test : when to rank further tests: while the cause is "open", "always", or "never"
    catalogue : possible effects; those of the package if left out
    executor, workers : where models are built and hypotheses are fitted, as for `cb.sequence`
    watch : progress display; none if left out

    Raises
    ------
    ValueError
        If a plate cannot be read or diagnosed, or if the plates cannot share their constants.

    Examples
    --------
    >>> import cpam_bayes as cb
    >>> result = cb.diagnose("A1", next_test="never")
    >>> result.claim, [cause.name for cause in result.diagnosis.causes[:2]]
    ('undecided', ['none', 'other'])
    """
    require_seed(seed)
    require_number("scatter", scatter, MAX_SCATTER)
    require_choice("next_test", next_test, ("open", "always", "never"))
    if prior_none is not None:
        require_number("prior_none", prior_none, MAX_PRIOR_NONE)
    if not 1 <= len(plates) <= MAX_PLATES:
        raise ValueError(
            f"plates: received {len(plates) or 'none'}, accepted: one plate or more, {MAX_PLATES} at most"
        )
    specimens = tuple(require_diagnosable(read_plate(plate)) for plate in plates)
    require_one_material(specimens)
    for specimen in specimens:
        require_reachable(specimen)
    names = " ".join(s.name for s in specimens)
    title = f"diagnose {names}"

    def announce(text: str, name: str = names) -> None:
        watch.announce(f"diagnose {name}: {text}")

    cases = []
    with open_executor(executor, workers) as pool:
        ready(pool)
        for specimen in specimens:
            with explained_failures(specimen):
                cases.append(plate_case(specimen, partial(announce, name=specimen.name)))
        diagnosis = _diagnosed(cases, title, scatter, prior_none, catalogue or CATALOGUE, pool, watch)
        candidates: tuple[Candidate, ...] = ()
        if next_test != "never" and is_time_up():
            cut_short("cut_next_tests")
        elif next_test != "never":
            always = next_test == "always"
            candidates = next_measurements(
                diagnosis, always=always, scatter=scatter, executor=pool, notify=announce
            )
    result = diagnosis_result(diagnosis, seed, scatter, candidates)
    notices = (*_slips(diagnosis, specimens), *diagnosis_notices(diagnosis), *beyond_theory(result))
    measurements = [s.measurement for s in specimens if s.measurement is not None]
    return replace(result, notices=each_once((*notices, *(n for m in measurements for n in m.notices))))


def _slips(diagnosis: Diagnosis, specimens: Sequence[Specimen]) -> tuple[Notice, ...]:
    fit = diagnosis.extended or diagnosis.baseline
    unknowns = {name for specimen in specimens for name in specimen.unknowns.names}
    return (
        *(slip for specimen in specimens for slip in stated_slips(specimen)),
        *equal_list_slips(specimens),
        *count_slips(len(diagnosis.baseline.measured), len(unknowns)),
        *bound_slips(
            c for c in fit_constants(diagnosis, diagnosis.baseline) if _at_stated_bound(c, specimens)
        ),
        *misfit_slips(fit.rms),
        *(slip for specimen in specimens for slip in reference_slips(specimen)),
    )


def _at_stated_bound(constant: Constant, specimens: Sequence[Specimen]) -> bool:
    """Whether a constant is pushed against a bound of a plate file, not against where its prior ends."""
    end = constant.prior.lower if constant.bound == "lower" else constant.prior.upper
    stated = [p.prior for s in specimens for p in s.unknowns.parameters if p.name == constant.name]
    return constant.bound is not None and any(end in (prior.lower, prior.upper) for prior in stated)


def diagnosis_result(
    diagnosis: Diagnosis,
    seed: int,
    scatter: float = DEFAULT_SCATTER,
    candidates: tuple[Candidate, ...] = (),
) -> DiagnosisResult:
    """The result of a diagnosis: with the mode of each frequency, mode shapes and the shifts by air."""
    specimens = tuple(case.models.specimen for case in diagnosis.cases)
    extended = diagnosis.extended
    return DiagnosisResult(
        seed=seed,
        diagnosis=diagnosis,
        plates=specimens,
        air_shifts=tuple(air_shifts(specimen) for specimen in specimens),
        plain=paired_fit(diagnosis, diagnosis.baseline, diagnosis.weighed.none),
        extended=None if extended is None else paired_fit(diagnosis, extended, diagnosis.members[0][0]),
        mode_shapes=plain_mode_shapes(diagnosis),
        scatter=scatter,
        candidates=candidates,
    )


def _diagnosed(
    cases: Sequence[PlateCase],
    title: str,
    scatter: float,
    prior_none: float | None,
    catalogue: tuple[Effect, ...],
    executor: Executor | None,
    watch: Watch,
) -> Diagnosis:
    hypotheses = hypotheses_of(cases, catalogue)
    if prior_none is not None:
        hypotheses = with_prior_of_none(hypotheses, prior_none)
    n, titles = len(hypotheses), titles_of(h for h, _ in hypotheses)
    with watch.stage(title, n, counted="hypotheses") as shown:

        def progress(done: int, total: int) -> None:
            if done <= n:
                shown.tick(done, float(done))
            elif done == n + 1:
                shown.notify(f"{total - n} pairs of causes")

        def built(done: int, total: int) -> None:
            if done == total or done % max(1, total // 10) == 0:
                shown.notify(f"building {done} of {total} models")

        build_models(cases, hypotheses, executor, built)
        return diagnose_cases(
            cases,
            hypotheses=hypotheses,
            scatter=scatter,
            executor=executor,
            notify=shown.notify,
            progress=progress,
            so_far=lambda shares: shown.found({titles.get(name, name): p for name, p in shares.items()}),
        )


# A larger residual, in standard deviations, is marked.
_FAR_SD: Final = 2.5
# Causes shown: those above this probability, up to this many.
_LEAST, _MOST = 0.005, 10
_TESTS_SHOWN: Final = 5


@present.register
def _present(result: DiagnosisResult) -> Report:
    return Report(
        summary=summary(result),
        sections=_sections(result),
        document=document(result, headline(result)),
        drawings=drawings(result),
        rows=tables(result),
    )


def _sections(result: DiagnosisResult) -> tuple[Section, ...]:
    """The finding and the fit of each mode, then the evidence for the claim, folded."""
    d = result.diagnosis
    drawn = {drawing.name for drawing in drawings(result)}

    def figure(name: str) -> tuple[str, ...]:
        return (name,) if name in drawn else ()

    claimed = d.extended is not None
    return (
        Section(
            "What was found" if claimed else "The plate and the fit of each mode",
            (_laboratory(d), _frequencies(result)),
            ("plate", "residuals"),
            folded=False,
        ),
        *peak_sections(result.plates[0], taken_peaks(result)),
        Section(
            "How it was noticed" if claimed else "How well the model fits",
            (_misfit(d, d.baseline, "The model without it" if claimed else "The model"),),
        ),
        Section(
            "Probability of each cause",
            (
                *_causes(result),
                remarks("Assumed sizes of errors", (sensitivity_sentence(d),)),
                remarks("Not tested", d.weighed.not_tested),
            ),
            figure("causes"),
        ),
        Section("Detection limits", (*_detectable(result), _hidden(d)), figure("detectable")),
        Section(
            "Constants and gain",
            (_constants(d), _relied(d), _gain(d)),
            figure("constants"),
        ),
        Section("Which causes look alike", figures=figure("signatures")),
        Section("Further steps", (*further_steps(next_steps(result)[1:]).tables, _next(result))),
        _plates_section(result),
        Section(COMPUTATION, (_work(d, result.seed),)),
    )


def _laboratory(d: Diagnosis) -> Table:
    """Checks for the laboratory, where one does not suffice."""
    found = checked_effects(d) if d.claim.kind not in ("undecided", OTHER) else ()
    return facts("Laboratory checks", ((e.title, e.check) for e in found) if len(found) > 1 else ())


def _misfit(d: Diagnosis, fit: Fit, title: str) -> Table:
    """Size of the residuals, and whether noise alone explains them."""
    rows = [
        ("misfit", f"{significant(100 * fit.rms, 3)} %, root mean square of the residuals"),
        ("p-value", f"{_p_value(d, fit)}; small speaks against the model"),
    ]
    noise = inferred_noise(d.weighed.plain if fit is d.baseline else d.members)
    if noise is not None:
        level, spread = with_spread(100 * noise[0], 100 * noise[1])
        rows.append(("noise", f"{level} +- {spread} % of a frequency, inferred; {noise_word(noise[0])}"))
    rows += [
        ("noise", f"{significant(100 * level, 2)} % of a frequency, {source}; {noise_word(level)}")
        for level, source in stated_levels(d)
    ]
    far = sorted(zip(np.abs(fit.standardised), fit.measured, strict=True), reverse=True)[:FEW]
    rows.append(("farthest off", ", ".join(f"{f:g} Hz by {z:.1f} sd" for z, f in far)))
    return facts(title, rows)


def _p_value(d: Diagnosis, fit: Fit) -> str:
    inferred = d.weighed.none.marginal.comparison.noise is not None
    noise = "the assumed repeatability" if inferred else "the stated repeatability"
    return f"{probability_text(fit.predictive_p)}, the probability of residuals as large with {noise}"


def _frequencies(result: DiagnosisResult) -> Table:
    """Each frequency with its mode, by the plain model and, where there is a claim, the extended one."""
    d, before = result.diagnosis, result.plain.frequencies
    after = before if result.extended is None else result.extended.frequencies
    decimals = decimals_of(d.baseline.measured)

    def hertz(value: float) -> str:
        return fixed(value, decimals + 1)

    columns = [
        Column("plate", value=lambda r: r[0].plate if len(d.cases) > 1 else None),
        Column("mode", value=lambda r: r[1].number or "-", number=True),
        Column("label", value=lambda r: r[1].mode and r[1].mode.label),
        Column("kind", value=lambda r: r[1].mode.kind if r[1].mode else "no mode"),
        Column("measured Hz", value=lambda r: r[0].measured, text=lambda f: fixed(f, decimals), number=True),
        *_fit_columns(0, "predicted Hz" if result.extended is None else "without it Hz", hertz),
    ]
    if result.extended is not None:
        columns += [*_fit_columns(1, "with it Hz", hertz), Column("", value=_other_mode)]
    pairs = tuple(zip(before, after, strict=True))
    shown = Rows("frequencies", tuple(columns), pairs, lambda r: _is_far(r[1])).table(
        "Fit of each mode, residual = predicted / measured - 1"
    )
    missed = (result.extended or result.plain).missed
    if not missed:
        return shown
    heads = shown.headings or ()
    rows = []
    for m in missed:
        cells = {
            "plate": m.plate, "mode": str(m.number), "label": m.mode.label, "kind": m.mode.kind,
            "measured Hz": "missed", heads[heads.index("measured Hz") + 1]: hertz(m.mode.frequency),
        }  # fmt: skip
        rows.append(tuple(cells.get(head, "") for head in heads))
    return Table(shown.title, shown.columns, (*shown.rows, *rows), shown.flagged)


def _fit_columns(i: int, heading: str, hertz: Callable[[float], str]) -> tuple[Column, ...]:

    def of(row: tuple[FrequencyRow, FrequencyRow], value: str) -> float | None:
        return None if row[i].predicted is None else getattr(row[i], value)

    return (
        Column(heading, value=lambda r: of(r, "predicted"), text=hertz, number=True),
        Column(
            "residual %", value=lambda r: of(r, "residual_percent"), text=lambda v: signed(v, 2), number=True
        ),
        Column("in sd", value=lambda r: of(r, "standardised"), text=lambda v: signed(v, 1), number=True),
    )


def _is_far(row: FrequencyRow) -> bool:
    return row.predicted is not None and abs(row.standardised) > _FAR_SD


def _other_mode(row: tuple[FrequencyRow, FrequencyRow]) -> str | None:
    """The mode of a frequency under the plain model, where it differs."""
    before, after = row
    if after.number == before.number:
        return None
    return "was no mode" if before.mode is None else f"was mode {before.number}, {before.mode.label}"


def _rows(result: DiagnosisResult, name: str) -> Rows:
    return next(rows for rows in tables(result) if rows.name == name)


def _causes(result: DiagnosisResult) -> tuple[Table, ...]:
    """The most probable causes with their sizes, and the total of the others."""
    d = result.diagnosis
    shown = leading(d, _LEAST, _MOST)
    rows = replace(_rows(result, "hypotheses"), rows=shown)
    rest = [c for c in d.causes if c not in shown]
    more = f"{len(rest)} more, {probability_text(sum(c.probability for c in rest))} together."
    return rows.table("Probability of each cause"), remarks("Further causes", (more,) if rest else ())


def _detectable(result: DiagnosisResult) -> tuple[Table, Table]:
    """Detection limits of the causes, and the causes that these data cannot show."""
    rows = _rows(result, "detectable")
    seen = tuple(row for row in rows.rows if row.smallest is not None)
    unseen = tuple(row for row in rows.rows if row.smallest is None)
    return (
        replace(rows, rows=seen).table(
            "Detection limits: smallest size that shows in 95 of 100 tests; sd: as assumed for the error"
        ),
        replace(rows, rows=unseen).table("Cannot be seen in this test"),
    )


def _hidden(d: Diagnosis) -> Table:
    """Causes that the constants imitate, and the shift of each constant."""
    names = [c.name for c in answer_constants(d)]
    columns = (
        Heading("error"),
        Heading("of size"),
        Heading("visible", number=True),
        *(Heading(f"{name} %", number=True) for name in names),
    )
    rows = []
    for cause in d.hidden_causes:
        _, unit, per_unit = absorbed_biases(d, cause)
        one = catalogue_sd(cause)
        moved = [f"{one * per_unit.get(user_name(name), 0.0):+.2g}" for name in names]
        size = f"{one:g} {unit}".strip()
        rows.append((title_of(d, cause.name), size, f"{100 * cause.visible:.0f} %", *moved))
    return Table("Errors absorbed by the constants, and their effect", columns, tuple(rows))


def _constants(d: Diagnosis) -> Table:
    """Mean and 95 % interval by the plain model, by the extended model, and of the answer."""
    without = {c.name: c for c in fit_constants(d, d.baseline)}
    extended = {c.name: c for c in fit_constants(d, d.extended)} if d.extended is not None else {}
    columns = (
        Column("constant", value=lambda c: c.name),
        Column("unit", value=lambda c: unit_of(c.name)),
        Column("reference", value=lambda c: to_user(c.name, c.reference), text="{:.5g}".format, number=True),
        Column("plain model", value=lambda c: without.get(c.name), text=_with_interval, number=True),
        Column("with what was found", value=lambda c: extended.get(c.name), text=_with_interval, number=True),
        Column("answer", value=lambda c: c, text=_with_interval, number=True),
        Column("", value=lambda c: c.verdict.value),
    )
    rows = answer_constants(d)
    return Rows("constants", columns, rows).table(
        "Constants, mean and 95 % interval; the answer: averaged over all causes by their probability"
    )


def _with_interval(c: Constant) -> str:
    assert c.interval is not None
    mean, low, high = (
        with_spread(to_user(c.name, v), to_user(c.name, c.sd))[0] for v in (c.value, *c.interval)
    )
    return f"{mean} ({low} to {high})"


def _relied(d: Diagnosis) -> Table:
    """Priors of other constants on which intervals depend."""
    priors = {c.name: c.prior for c in answer_constants(d)}
    said = reliance_sentences(d.reliances, priors.__getitem__, shown_constants(d))
    return remarks("What the intervals depend on", said)


def _gain(d: Diagnosis) -> Table:
    if d.gain is None or d.extended is None:
        return facts("Gain", ())
    gain = d.gain
    before, after = (significant(100 * rms, 3) for rms in (gain.rms_before, gain.rms_after))
    score, se = with_spread(gain.held_out_difference, gain.held_out_se)
    score = score if score.startswith("-") else f"+{score}"
    rows = (
        ("rms misfit", f"{before} % before, {after} % after"),
        ("log Bayes factor", f"{signed(gain.log_bayes_factor, 1)} against the plain model"),
        ("held-out modes", f"log score {score} +- {se}, each predicted from the others"),
        ("selection", f"repeated without each frequency, among {gain.n_hypotheses} hypotheses"),
        ("stable", f"better without one frequency in {100 * gain.stable:.0f} % of the cases"),
        ("p-value", f"{_p_value(d, d.extended)}, with what was found"),
    )
    return facts("Gain of the extended model", rows)


def _next(result: DiagnosisResult) -> Table:
    rows = _rows(result, "next_measurement")
    further = len(rows.rows) - _TESTS_SHOWN
    more = f", {further} weaker ones not shown" if further > 0 else ""
    shown = replace(rows, rows=rows.rows[:_TESTS_SHOWN])
    return shown.table(f"Further tests, ranked by information about the cause{more}")


def _plates_section(result: DiagnosisResult) -> Section:
    specimens = result.plates
    if len(specimens) == 1:
        plate = plate_section(specimens[0], result.air_shifts[0])
        return Section("The plate and its measurement", plate.tables)
    columns = (
        Column("plate", value=lambda r: r[0].name),
        Column("specimen", value=lambda r: r[0].specimen),
        Column("edges", value=lambda r: r[0].plate.edges),
        Column("frequencies", value=lambda r: r[1].measurement.size, number=True),
    )
    rows = tuple(zip(specimens, result.diagnosis.cases, strict=True))
    shifts = zip(specimens, result.air_shifts, strict=True)
    air = facts("Air", tuple((s.name, air_text(s, shift)) for s, shift in shifts))
    notes = tuple(f"{s.name}: {note}" for s in specimens for note in s.notes)
    material = specimens[0].material.name or "not named"
    table = Rows("plates", columns, rows).table(f"Plates of one material, {material}")
    return Section("The plates and their measurements", (table, air, remarks("Notes", notes)))


def _work(d: Diagnosis, seed: int) -> Table:
    families = {t.hypothesis.family for t in d.weighed.tested} - {NONE, OTHER, SET}
    prior = d.weighed.none.hypothesis.prior
    other = prior_of([t for t in d.weighed.tested if t.hypothesis.cause == OTHER])
    several = sum(P_SETS.values()) * (1.0 - prior) / (1.0 - P_NONE)
    rows = (
        (
            "prior probabilities",
            f"nothing wrong {prior:g}, unknown error {other:.3g}, several at once {several:.3g}, the rest "
            f"shared equally by {len(families)} families of causes",
        ),
        (
            "work",
            f"{len(distinct_hypotheses(d.weighed.tested))} hypotheses in {d.seconds:.1f} s, seed {seed}",
        ),
        *(() if d.basis_error is None else (("reduced bases", basis_error_text(d.basis_error)),)),
    )
    return facts("Computation", rows)


COMMAND: Final = Command(
    diagnose,
    (
        PLATES,
        option(
            "--scatter",
            type=positive(MAX_SCATTER),
            default=DEFAULT_SCATTER,
            metavar="S",
            help="standard deviation of a constant from plate to plate of one material, relative, above 0, "
            f"at most {MAX_SCATTER:g} (default: {DEFAULT_SCATTER:g})",
        ),
        option(
            "--prior-none",
            type=positive(MAX_PRIOR_NONE),
            metavar="P",
            help="prior probability that nothing is wrong, above 0, at most "
            f"{MAX_PRIOR_NONE:g} (default: 0.5)",
        ),
        option(
            "--next",
            "next_test",
            choices=("open", "always", "never"),
            default="open",
            help="when to rank further tests by what they tell about the cause: while the cause is open, "
            "always, or never (default: open)",
        ),
        EXECUTOR,
        WORKERS,
        TIME_LIMIT,
    ),
)
