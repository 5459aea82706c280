"""`forward` in plain words."""

from __future__ import annotations

import numpy as np

from cpam_bayes.formatting import NOT_KNOWN, listed, signed, significant
from cpam_bayes.forward_model.preconditions import SUSPICIOUS_RATIO
from cpam_bayes.forward_model.solve import ForwardResult
from cpam_bayes.plate import to_user, unit_of
from cpam_bayes.report.forward.rows import constants_with_origin, list_is_paired, measured_of_modes
from cpam_bayes.report.plates.head import air_text
from cpam_bayes.report.sentences import plate_argument, plate_sentence
from cpam_bayes.report.summary import Summary
from cpam_bayes.report.tables import Table, headed


def summary(result: ForwardResult) -> Summary:
    """The frequencies, how exact they are, and how far they are from the measured ones."""
    f = result.frequencies
    many = "1 natural frequency" if len(f) == 1 else f"{len(f)} natural frequencies"
    span = significant(float(f[0]), 4) if len(f) == 1 else f"{significant(float(f[0]), 4)} to {f[-1]:.4g}"
    return Summary(
        title=f"forward {result.title}",
        slips=result.slips,
        headline=f"The plate has its {many} at {span} Hz with the constants of [material].{_beside(result)}",
        tables=(modes_table(result),),
        basis=(
            _constants(result),
            plate_sentence(result.specimen),
            f"Air: {air_text(result.specimen, result.air_shifts)}.",
            _error(result),
            *_unpaired(result),
        ),
        warnings=tuple(w for w in result.warnings if w not in result.slips),
        next_steps=_next_steps(result),
    )


def modes_table(result: ForwardResult) -> Table:
    """Each mode, beside the measured frequency where there is one."""
    measured = measured_of_modes(result.specimen, result.modes, result.by_shape)
    columns = list(headed("#mode", "#Hz", "kind", "label"))
    named = any(m is not None and m.by != "order" for m in measured)
    if any(measured):
        columns += headed("#measured Hz", "#difference %", *(("paired by",) if named else ()))
    rows = []
    for i, (mode, m) in enumerate(zip(result.modes, measured, strict=True), 1):
        row = [str(i), significant(mode.frequency, 6), mode.kind, mode.label]
        if m is not None:
            row += [f"{m.hz:.10g}", _difference(mode.frequency / m.hz)]
            row += [m.by] if named else []
        rows.append((*row, *("" for _ in columns[len(row) :])))
    return Table("Modes from these constants", tuple(columns), tuple(rows))


def _difference(ratio: float) -> str:
    """Computed over measured, as a difference in % or, where units must be wrong, as a factor."""
    if 1.0 / SUSPICIOUS_RATIO <= ratio <= SUSPICIOUS_RATIO:
        return signed(100.0 * (ratio - 1.0), 2)
    return f"{significant(ratio, 3)} times"


def _beside(result: ForwardResult) -> str:
    ratios = np.array(
        [
            mode.frequency / measured.hz
            for mode, measured in zip(
                result.modes, measured_of_modes(result.specimen, result.modes, result.by_shape), strict=True
            )
            if measured is not None
        ]
    )
    if not ratios.size:
        return ""
    if not 1.0 / SUSPICIOUS_RATIO <= float(np.median(ratios)) <= SUSPICIOUS_RATIO:
        low, high = (significant(float(v), 3) for v in (ratios.min(), ratios.max()))
        span = low if low == high else f"{low} to {high}"
        return f" They are {span} times the measured ones."
    off = ratios - 1.0
    rms = significant(100.0 * float(np.sqrt(np.mean(off**2))), 2)
    low, high = (signed(100.0 * float(v), 1) for v in (off.min(), off.max()))
    return f" They differ from the measured ones by {low} to {high} % ({rms} % root mean square)."


def _constants(result: ForwardResult) -> str:
    said = [
        f"{name} {to_user(name, value):.5g} {unit_of(name)}".rstrip() + f" ({origin})"
        for name, value, origin in constants_with_origin(result.specimen)
    ]
    return f"The constants: {listed(said, 'and')}."


def _error(result: ForwardResult) -> str:
    worst = float(np.max(result.error))
    if not np.isfinite(worst):
        return f"Solver: {result.solver}; the error of its frequencies is {result.no_estimate or NOT_KNOWN}."
    return (
        f"Solver: {result.solver}; its frequencies are exact to about {significant(100 * worst, 2)} %, which "
        "says nothing about errors of the constants or of the plate."
    )


def _unpaired(result: ForwardResult) -> tuple[str, ...]:
    if list_is_paired(result):
        return ()
    return (
        "The frequency list may lack modes (complete = false): a frequency without a label or shape stands "
        "beside no mode here; identify --backend emcee sums over all pairings.",
    )


def _next_steps(result: ForwardResult) -> tuple[str, ...]:
    specimen = result.specimen
    if specimen.measurement is None or not specimen.unknowns.size:
        missing = "[measurement]" if specimen.measurement is None else "[unknowns]"
        return (f"Add {missing} to the plate file to identify the constants from measured frequencies.",)
    plate = plate_argument(specimen)
    return (f"Identify the constants from the measured frequencies: cpam-bayes identify {plate}",)
