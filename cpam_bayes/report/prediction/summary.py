"""`predict` in plain words."""

from __future__ import annotations

from cpam_bayes.formatting import listed, significant, with_spread
from cpam_bayes.plate import to_user, unit_of
from cpam_bayes.prediction.predict import PredictedMode, PredictionResult
from cpam_bayes.report.forward.rows import MeasuredFrequency, measured_of_modes
from cpam_bayes.report.plates.head import air_text
from cpam_bayes.report.sentences import plate_argument, plate_sentence
from cpam_bayes.report.summary import Summary
from cpam_bayes.report.tables import Table, headed


def summary(result: PredictionResult) -> Summary:
    """The frequencies with their intervals, and what they rest on."""
    measured = measured_of_modes(result.specimen, [m.mode for m in result.modes])
    relative = [m.sd / m.mean for m in result.modes]
    low, high = (significant(100.0 * v, 2) for v in (min(relative), max(relative)))
    known = f"{low} %" if low == high else f"{low} to {high} %"
    many = "frequency is" if len(result.modes) == 1 else f"{len(result.modes)} lowest frequencies are"
    return Summary(
        title=f"predict {result.title}",
        slips=result.slips,
        headline=(f"The {many} predicted with a standard deviation of {known}.{_beside(result, measured)}"),
        tables=(_frequencies(result, measured),),
        basis=(
            _posterior(result),
            plate_sentence(result.specimen),
            _sizes(result),
            _noise(result),
            f"Air: {air_text(result.specimen, result.air_shifts)}.",
        ),
        warnings=tuple(w for w in result.warnings if w not in result.slips),
        next_steps=_next_steps(result),
    )


def _frequencies(result: PredictionResult, measured: list[MeasuredFrequency | None]) -> Table:
    """Each mode with its interval, beside the measured frequency where there is one."""
    columns = list(headed("#mode", "#Hz", "#sd", "95 % interval", "a measurement", "kind", "label"))
    if any(measured):
        columns += headed("#measured Hz", "")
    rows, flagged = [], []
    for i, (m, there) in enumerate(zip(result.modes, measured, strict=True)):
        mean, sd = with_spread(m.mean, m.sd)
        low, high, lower, upper = (
            with_spread(v, m.sd)[0] for v in (m.q025, m.q975, m.measured_q025, m.measured_q975)
        )
        row = [str(i + 1), mean, sd, f"{low} to {high}", f"{lower} to {upper}", m.mode.kind, m.mode.label]
        if any(measured):
            outside = there is not None and not _within(m, there)
            row += ["" if there is None else f"{there.hz:.10g}", "outside" if outside else ""]
            flagged += [i] if outside else []
        rows.append(tuple(row))
    return Table("Predicted frequencies", tuple(columns), tuple(rows), frozenset(flagged))


def _within(m: PredictedMode, there: MeasuredFrequency) -> bool:
    return m.measured_q025 <= there.hz <= m.measured_q975


def _beside(result: PredictionResult, measured: list[MeasuredFrequency | None]) -> str:
    pairs = [(m, f) for m, f in zip(result.modes, measured, strict=True) if f is not None]
    if not pairs:
        return ""
    inside = sum(_within(m, f) for m, f in pairs)
    return f" Of {len(pairs)} measured frequencies {inside} lie where a measurement is expected."


def _posterior(result: PredictionResult) -> str:
    stored = result.posterior
    said = []
    for name in stored.constants:
        values = stored.draws[name]
        mean, sd = (to_user(name, float(v)) for v in (values.mean(), values.std(ddof=1)))
        value, spread = with_spread(mean, sd)
        said.append(f"{name} {value} +- {spread} {unit_of(name)}".rstrip())
    of = f" of {stored.plate}" if stored.plate else ""
    return (
        f"The constants: {len(result.frequencies)} draws of the posterior{of} in {stored.source}, "
        f"{listed(said, 'and')}, with their correlations."
    )


def _sizes(result: PredictionResult) -> str:
    if result.sizes_of_posterior:
        return (
            "The plate is the one that was measured: its sizes vary with the constants as in the posterior."
        )
    sd = result.specimen.plate.sd
    if not sd:
        return (
            "The sizes and the mass of the plate are taken for exact: [plate.sd] would widen the intervals."
        )
    return f"The intervals contain the stated uncertainty of {listed(list(sd), 'and')} in [plate.sd]."


def _noise(result: PredictionResult) -> str:
    stored = result.posterior
    relative = stored.draws.get("relative_std")
    if "absolute_sd" in stored.draws:
        level = f"{significant(float(stored.draws['absolute_sd'].mean()), 2)} Hz"
    elif relative is not None:
        level = f"{significant(100.0 * float(relative.mean()), 2)} % of a frequency"
    elif stored.repeatability is not None:
        level = f"{significant(100.0 * stored.repeatability, 2)} % of a frequency"
    else:
        return "The file says nothing of the noise of a measurement."
    return (
        f"A measurement is expected to scatter by {level}, the noise of the posterior; an error that the "
        "plate model has for one plate and not for the other is not in it."
    )


def _next_steps(result: PredictionResult) -> tuple[str, ...]:
    plate = plate_argument(result.specimen)
    steps = []
    if result.specimen.measurement is None:
        steps.append("Measure the plate, add [measurement] to its file, and see whether it lies in there.")
    elif result.specimen.unknowns.size:
        steps.append(f"Identify this plate by itself and compare: cpam-bayes identify {plate}")
    if result.specimen.unknowns.size:
        steps.append(f"See which specimen would say more of the constants: cpam-bayes design {plate}")
    return tuple(steps)
