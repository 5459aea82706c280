"""Screen of `diagnose`: what the model gets wrong, what explains it, and what that is worth."""

from __future__ import annotations

from collections.abc import Sequence

from cpam_bayes.diagnosis.diagnose import Cause, Diagnosis
from cpam_bayes.diagnosis.evidence.tested import distinct_hypotheses, prior_of
from cpam_bayes.diagnosis.extension import Resampled
from cpam_bayes.diagnosis.hypotheses import NONE, OTHER, P_NONE, P_PAIR
from cpam_bayes.diagnosis.next_test.next_measurement import Candidate
from cpam_bayes.diagnosis.paired_modes import FrequencyRow
from cpam_bayes.diagnosis.plates import DiagnosisResult
from cpam_bayes.formatting import decimals_of, fixed, signed, significant, with_spread
from cpam_bayes.report.diagnosis.rows import (
    absorbed_biases,
    averaged_rows,
    catalogue_sd,
    constant_rows,
    detectable_rows,
    hidden_causes,
    leading,
    noise_of,
    sampled_rows,
    shows_constants,
    shows_detectable,
    shows_signatures,
)
from cpam_bayes.report.diagnosis.words import (
    detectable_size,
    p_value_text,
    probability_text,
    sensitivity_sentence,
    size_text,
    with_title,
)
from cpam_bayes.report.plates.head import air_text, plate_section
from cpam_bayes.report.sections import COMPUTATION, Section
from cpam_bayes.report.tables import Column, Table, facts, headed, remarks

# A residual of so many standard deviations is marked.
_MAX_DISTANCE_SD = 2.5
# Causes shown: those with this probability, so many at most; and names listed as alike at most.
_LEAST, _MOST, _ALIKE = 0.005, 10, 3
_NEXT = 5


def sections(result: DiagnosisResult) -> tuple[Section, ...]:
    """Claim and causes, residuals, what could have been seen, constants and gain, what to measure next."""
    d = result.diagnosis
    several = ("signatures",) if shows_signatures(d) else ()
    sizes = ("detectable",) if shows_detectable(d) else ()
    constants = ("constants",) if shows_constants(d) else ()
    return (
        _plates_section(result),
        Section(
            "What the plate model gets wrong",
            (_checks(d), _misfit(d), _residuals(result)),
            ("residuals",),
            folded=False,
        ),
        Section(
            "Causes by their probability",
            (
                _causes(d),
                remarks("Other scales of the priors", (sensitivity_sentence(d),)),
                remarks("Not tested", d.weighed.not_tested),
            ),
            ("causes",),
            folded=False,
        ),
        Section("Which causes look alike", figures=several),
        Section("What these data could have shown", (_detectable(d), _hidden(d)), sizes),
        Section(
            "Constants and gain",
            (_constants(d), _sampled(d, result.resampled), _gain(d)),
            constants,
        ),
        Section("What to measure next", (_next(result.candidates),)),
        Section(COMPUTATION, (_work(d, result.seed),)),
    )


def _plates_section(result: DiagnosisResult) -> Section:
    specimens = result.plates
    if len(specimens) == 1:
        return plate_section(specimens[0], result.air_shifts[0])
    columns = headed("plate", "specimen", "edges", "#frequencies")
    rows = tuple(
        (s.name, s.specimen, s.plate.edges, str(case.measurement.size))
        for s, case in zip(specimens, result.diagnosis.cases, strict=True)
    )
    shifts = zip(specimens, result.air_shifts, strict=True)
    air = facts("Air", tuple((s.name, air_text(s, shift)) for s, shift in shifts))
    notes = tuple(f"{s.name}: {note}" for s in specimens for note in s.notes)
    material = specimens[0].material.name
    title = f"diagnose {result.title}, material {material or 'not named'}"
    return Section(
        "The plates and their measurements",
        (Table(title, columns, rows), air, remarks("Notes", notes)),
        ("plate",),
        folded=False,
    )


def _checks(d: Diagnosis) -> Table:
    """What the claimed causes are, and how the laboratory can check each."""
    claimed = [c for c in d.causes if c.name in d.claim.causes and d.claim.kind != "undecided"]
    records = (effect for cause in claimed for effect in cause.hypothesis.records)
    return facts("To check in the laboratory", tuple((e.title, e.check) for e in records))


def _misfit(d: Diagnosis) -> Table:
    """How large the residuals are, and whether noise alone explains them."""
    rows = (
        ("misfit", f"{significant(100 * d.baseline.rms, 3)} %, root mean square of the residuals"),
        ("p-value", f"{p_value_text(d, d.baseline)}; small speaks against the plain model"),
    )
    return facts("How well the plain model fits", rows)


def _residuals(result: DiagnosisResult) -> Table:
    """Each frequency against the plain model and, where there is one, the extended one."""
    d, before = result.diagnosis, result.plain.frequencies
    after = None if result.extended is None else result.extended.frequencies
    several = len(d.cases) > 1
    columns = list(headed("plate")) if several else []
    columns += headed("#mode", "label", "kind", "#measured Hz", "#predicted Hz", "#residual %", "#in sd")
    if after is not None:
        columns += headed("#extended Hz", "#residual %", "#in sd", "")
    rows, far = [], []
    decimals = decimals_of(d.baseline.measured)
    for i, row in enumerate(before):
        cells = [row.plate] if several else []
        cells += _mode_cells(row)
        cells += [fixed(row.measured, decimals), *_fit_cells(row, decimals)]
        if after is not None:
            cells += [*_fit_cells(after[i], decimals), _moved(row, after[i])]
        if row.predicted is not None and abs(row.standardised) > _MAX_DISTANCE_SD:
            far.append(i)
        rows.append(tuple(cells))
    rows += _missed_rows(result, len(columns), several, decimals)
    title = "What the plain model gets wrong, residual = predicted / measured - 1"
    return Table(title, tuple(columns), tuple(rows), frozenset(far))


def _mode_cells(row: FrequencyRow) -> list[str]:
    if row.number is None or row.mode is None:
        return ["-", "", "no mode"]
    return [str(row.number), row.mode.label, row.mode.kind]


def _fit_cells(row: FrequencyRow, decimals: int) -> list[str]:
    if row.predicted is None or row.residual_percent is None:
        return ["", "", ""]
    return [
        fixed(row.predicted, decimals + 1),
        signed(row.residual_percent, 2),
        signed(row.standardised, 1),
    ]


def _moved(before: FrequencyRow, after: FrequencyRow) -> str:
    """What the extended model says of a frequency's mode where that is another one."""
    if after.number == before.number:
        return ""
    if after.mode is None:
        return "no mode"
    return f"is mode {after.number}, {after.mode.label}"


def _missed_rows(result: DiagnosisResult, width: int, several: bool, decimals: int) -> list[tuple[str, ...]]:
    rows = []
    for m in (result.extended or result.plain).missed:
        cells = [m.plate] if several else []
        cells += [str(m.number), m.mode.label, m.mode.kind, "missed", fixed(m.mode.frequency, decimals + 1)]
        rows.append((*cells, *(width - len(cells)) * ("",)))
    return rows


def _causes(d: Diagnosis) -> Table:
    several = len(d.cases) > 1
    columns = list(headed("cause", "variant"))
    columns += headed("of") if several else []
    columns += headed("#probability", "#scales x 3", "#scales / 3", "#log Bayes factor")
    columns += headed("size, mean and sd", "indistinguishable from")
    rows, claimed = [], []
    shown = leading(d, _LEAST, _MOST)
    for i, cause in enumerate(shown):
        cells = [with_title(d, cause.name), cause.variant]
        cells += [_plates(d, cause)] if several else []
        cells += [
            probability_text(cause.probability),
            *(probability_text(p[cause.name]) for p in d.sensitivity.probabilities),
            "0" if cause.name == NONE else signed(cause.log_bayes_factor, 1),
            _size(cause),
            _alike(cause),
        ]
        if cause.name in d.claimed:
            claimed.append(i)
        rows.append(tuple(cells))
    further = len(d.causes) - len(shown)
    rest = sum(c.probability for c in d.causes) - sum(c.probability for c in shown)
    if further > 0:
        width = len(columns) - 1
        rows.append(
            (
                f"{further} more",
                *((width - 6) * ("",)),
                probability_text(rest),
                *(5 * ("",)),
            )
        )
    return Table("Causes, posterior probability", tuple(columns), tuple(rows), frozenset(claimed))


def _plates(d: Diagnosis, cause: Cause) -> str:
    if cause.name in (NONE, OTHER) or len(cause.plates) == len(d.cases):
        return "all"
    return ", ".join(cause.plates)


def _size(cause: Cause) -> str:
    text = size_text(cause)
    return f"{text} (hidden)" if cause.absorbed and text else text


def _alike(cause: Cause) -> str:
    names = cause.indistinguishable_from
    more = f" and {len(names) - _ALIKE} more" if len(names) > _ALIKE else ""
    return ", ".join(names[:_ALIKE]) + more


def _hidden(d: Diagnosis) -> Table:
    """Causes that the constants imitate, and by how much each constant moves."""
    names = [row.name for row in constant_rows(d, d.baseline)]
    columns = (
        Column("error"),
        Column("shows", number=True),
        Column("of size"),
        *(Column(f"{name.removesuffix('_GPa')} %", number=True) for name in names),
    )
    rows = []
    for cause in hidden_causes(d):
        _, unit, per_unit = absorbed_biases(d, cause)
        one = catalogue_sd(cause)
        moved = [f"{one * per_unit.get(name, 0.0):+.2g}" for name in names]
        rows.append(
            (with_title(d, cause.name), f"{100 * cause.visible:.0f} %", f"{one:g} {unit}".strip(), *moved)
        )
    title = (
        "Errors that the constants absorb: how much of an error of this size shows in the frequencies, and "
        "how far it moves each constant"
    )
    return Table(title, columns, tuple(rows))


def _constants(d: Diagnosis) -> Table:
    """Mean and 95 % interval by the plain model and by what is claimed, or over all hypotheses."""
    before = constant_rows(d, d.baseline)
    answer = averaged_rows(d) if d.extended is None else constant_rows(d, d.extended)
    after = {row.name: row for row in answer}
    second = "averaged" if d.extended is None else "extended"
    columns = headed(
        "constant", "#reference", "#mean", "#2.5 %", "#97.5 %", f"#{second}", "#2.5 %", "#97.5 %"
    )
    rows = []
    for row in before:
        last = after.get(row.name, row)
        cells = [row.name, f"{row.reference:.5g}", *_interval(row.mean, row.q025, row.q975, row.sd)]
        cells += _interval(last.mean, last.q025, last.q975, last.sd) if row.name in after else 3 * [""]
        rows.append((*cells, last.verdict.removeprefix("determined by ")))
    over = "averaged over all hypotheses by their probability" if d.extended is None else "extended model"
    return Table(f"Constants, plain model and {over}", (*columns, Column("determined by")), tuple(rows))


def _interval(mean: float, low: float, high: float, sd: float) -> list[str]:
    return [with_spread(value, sd)[0] for value in (mean, low, high)]


def _sampled(d: Diagnosis, resampled: Resampled | None) -> Table:
    """The extended model's constants by emcee, and how its chains did."""
    if resampled is None:
        return facts("Extended model by emcee", ())
    rows = []
    for row in sampled_rows(d, resampled):
        mean, low, high = _interval(row.mean, row.q025, row.q975, row.sd)
        rows.append((row.name, f"{mean}, 95 % interval {low} to {high}"))
    worst = max(m.diagnostics.r_hat for m in resampled.members)
    size = min(m.diagnostics.ess_bulk for m in resampled.members)
    state = "converged" if resampled.converged else "NOT converged"
    rows.append(("chains", f"R-hat {worst:.4f}, {size:.0f} effective samples: {state}"))
    return facts("Extended model by emcee", tuple(rows))


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
        ("stable", f"ahead without one frequency in {100 * gain.stable:.0f} % of the cases"),
        ("p-value", f"{p_value_text(d, d.extended)}, the extended model being right"),
    )
    return facts("Gain of the extended model", rows)


def _detectable(d: Diagnosis) -> Table:
    """The smallest size of each cause that these data would have shown."""
    columns = headed(
        "kind of error", "key", "#smallest size that shows", "#times its usual size", "#chance that it shows"
    )
    rows = []
    for row in detectable_rows(d):
        in_sd = "" if row.in_sd is None else significant(row.in_sd, 2)
        p = "" if row.probability is None else fixed(row.probability, 2)
        rows.append((row.title, row.cause, detectable_size(row), in_sd, p))
    title = (
        "How large an error must be to show in these frequencies, in 95 of 100 repetitions; usual size: one "
        "standard deviation of the catalogue"
    )
    return Table(title, columns, tuple(rows))


def _next(candidates: Sequence[Candidate]) -> Table:
    columns = headed("test", "#information, nats", "#at most, nats", "#chance that it decides")
    rows = tuple(
        (c.description, fixed(c.information, 2), fixed(c.possible, 2), f"{100 * c.decided:.0f} %")
        for c in candidates[:_NEXT]
    )
    further = len(candidates) - len(rows)
    if further > 0:
        rows += ((f"{further} more that {'tells' if further == 1 else 'tell'} less", "", "", ""),)
    return Table("What to measure next, by what it would tell about the cause", columns, rows)


def _work(d: Diagnosis, seed: int) -> Table:
    noise = noise_of(d.weighed.plain)
    families = {t.hypothesis.family for t in d.weighed.tested} - {NONE, OTHER, "pair"}
    prior = d.weighed.none.hypothesis.prior
    other = prior_of([t for t in d.weighed.tested if t.hypothesis.cause == OTHER])
    pairs = P_PAIR * (1.0 - prior) / (1.0 - P_NONE)
    rows = []
    if noise is not None:
        level, spread = with_spread(100 * noise[0], 100 * noise[1])
        rows.append(
            ("noise", f"{level} +- {spread} % of a frequency, inferred from the misfit of the plain model")
        )
    rows += [
        (
            "priors",
            f"none {prior:g}, other {other:.3g}, two at once {pairs:.3g}, the rest evenly over "
            f"{len(families)} families of causes",
        ),
        (
            "work",
            f"{len(distinct_hypotheses(d.weighed.tested))} hypotheses in {d.seconds:.1f} s, seed {seed}",
        ),
    ]
    return facts("Computation", tuple(rows))
