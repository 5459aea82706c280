"""The four verdicts of a batch on its limits, the reason of each that is not a pass, and the certificate."""

from __future__ import annotations

import math
from functools import partial
from typing import Final

import numpy as np
from scipy.stats import chi2, norm

from cpam_bayes import __version__
from cpam_bayes.batches.limits import LEAST_PLATES, Limit
from cpam_bayes.batches.plate_row import PlateRow
from cpam_bayes.effects import CATALOGUE
from cpam_bayes.formatting import listed, significant, with_spread
from cpam_bayes.plate import to_user, unit_of
from cpam_bayes.questions.batch.result import CERTIFICATE, SURE, BatchResult, BatchVerdict, verdict
from cpam_bayes.render.report import Column, Rows, Section, facts

# Plates named per verdict, and causes named per plate.
_MOST_NAMED, _MOST_CAUSES = 3, 2
# Entries of a plate file about its test.
_STATED: Final = ("specimen", "laboratory", "operator", "date")
_IN_ORDER: Final[tuple[BatchVerdict, ...]] = ("pass", "fail", "cannot be judged", "too close to call")
_SLIPS: Final = {
    "sides": "length and width exchanged?",
    "layup": "the layup turned by 90 degrees?",
    "edges": "the neighbouring edge held?",
    "supports": "clamps that are simple supports, or the reverse?",
    "clamped": "clamped at an edge, not free?",
    "free": "free, not held?",
    "missed": "mode {number} missing from the list?",
    "false": "frequency {number} not a mode?",
    "misread": "frequency {number} misread?",
    "decimal": "a decimal point of frequency {number}?",
}
# p-value below which moduli share no factor, relative scatter that they may have all the same, and relative
# difference below which masses and thicknesses tell nothing.
_TOGETHER, _APART, _SAME = 0.01, 0.01, 0.005


def four_verdicts(result: BatchResult) -> str:
    """How many plates pass, fail, cannot be judged or are too close to call, and why."""
    said = []
    for which in _IN_ORDER:
        rows = [row for row in result.rows if verdict(result, row) == which]
        if not rows:
            continue
        text = f"{len(rows)} {which}"
        why = {row.name: reason for row in rows if (reason := _why(result, row, which))}
        if why:
            each = [f"{name}: {reason}" for name, reason in why.items()][:_MOST_NAMED]
            more = [f"{len(why) - _MOST_NAMED} more"] if len(why) > _MOST_NAMED else []
            text += f" ({'; '.join([*each, *more])})"
        said.append(text)
    return f"{', '.join(said)}."


def _why(result: BatchResult, row: PlateRow, which: BatchVerdict) -> str:
    if which == "cannot be judged":
        return why_not_judged(result, row)
    pattern = "" if which == "pass" else pattern_of(result, row)
    return pattern or (_modulus(result, row) if which == "fail" else "")


def pattern_of(result: BatchResult, row: PlateRow) -> str:
    """In words: a common factor of all moduli, read as a thickness where the mass agrees; "" for none."""
    factor = common_factor(result, row)
    if factor is None:
        return ""
    thin = factor < 1.0
    change = _of_thickness(result, row, factor)
    if change is None:
        return f"{'thinner or softer' if thin else 'thicker or stiffer'}; gauge it"
    return f"{'thinner' if thin else 'thicker'} by about {significant(100.0 * abs(change), 1)} %; gauge it"


def _modulus(result: BatchResult, row: PlateRow) -> str:
    """The constant that fails its limit most clearly."""
    limit = min(result.limits, key=lambda limit: result.probability(row, limit) or 0.0)
    constant = row.constant(limit.name)
    assert constant is not None
    value, sd = with_spread(to_user(limit.name, constant.value), to_user(limit.name, constant.sd))
    return f"{limit.name} {value} +- {sd} {unit_of(limit.name)}".rstrip()


def common_factor(result: BatchResult, row: PlateRow) -> float | None:
    """Common factor of a plate's moduli relative to the medians of the batch; None where there is none.

    A wrongly stated thickness h scales all moduli of a thin plate by one factor.
    """
    logs, sd = [], []
    for c in row.constants:
        chart = result.chart(c.name)
        if unit_of(c.name) and not c.is_open and chart is not None:
            logs.append(math.log(c.value / chart.median))
            sd.append(math.hypot(c.sd / c.value, chart.sigma / chart.median, _APART))
    if not logs:
        return None
    x, weight = np.array(logs), np.array(sd) ** -2.0
    mean = float(x @ weight / weight.sum())
    together = len(x) == 1 or chi2.sf(float(weight @ (x - mean) ** 2), len(x) - 1) >= _TOGETHER
    return math.exp(mean) if together and abs(mean) > 2.0 / math.sqrt(weight.sum()) else None


def _of_thickness(result: BatchResult, row: PlateRow, factor: float) -> float | None:
    """The relative change of thickness on which moduli and mass agree; None where they do not.

    For a weighed plate t times as thick as stated, moduli come out t^3 times, the density t times as large.
    """
    known = [other.density for other in result.judged if other.density is not None]
    if row.density is None or len(known) < LEAST_PLATES:
        return None
    by_mass = math.log(row.density / float(np.median(known)))
    by_moduli = math.log(factor) / 3.0
    agree = abs(by_mass) > _SAME and abs(by_mass - by_moduli) < max(_SAME, 0.5 * abs(by_moduli))
    return math.expm1(by_mass) if agree else None


def slip_question(kind: str, number: int) -> str:
    """A slip of a plate file as a question; number : of its mode or frequency."""
    return _SLIPS[kind].format(number=number)


def weighs_slip(slip: tuple[str, int]) -> bool:
    """Whether `diagnose` weighs a slip too, as it does slips of the list."""
    return slip[1] > 0


def why_not_judged(result: BatchResult, row: PlateRow) -> str:
    """Why a plate is not judged: no answer, a slip, a cause, a misfit, or undetermined constants."""
    if row.status == "failed":
        return "no answer"
    cause = _cause(row)
    if row.slip is not None and not (cause and _is_of_plate(row)):
        return slip_question(*row.slip)
    if row.misfit > 1.0:
        return cause or f"misfit {significant(row.misfit, 2)} times the noise"
    names = [limit.name for limit in result.limits]
    left = [n for n in dict.fromkeys(names) if (c := row.constant(n)) is None or c.is_open]
    return f"{listed(left, 'and')} not determined"


def _is_of_plate(row: PlateRow) -> bool:
    """Whether a diagnosis names a cause other than list errors, which a slip describes better."""
    of_list = {effect.name for effect in CATALOGUE if effect.pairings}
    return row.diagnosis is not None and not of_list.issuperset(row.diagnosis.causes)


def _cause(row: PlateRow) -> str:
    """The causes named by a diagnosis, as a question; "" for none."""
    found = row.diagnosis
    if found is None or found.claim not in ("named", "class", "pair") or len(found.causes) > 3:
        return ""
    effects = {effect.name: effect for effect in CATALOGUE}
    titles = [effects[name].title if name in effects else name for name in found.causes]
    first = effects.get(found.causes[0])
    if first is not None and found.size is not None and first.parameters:
        unit, factor = first.parameters[0].display
        size = f"{significant(abs(factor * found.size), 1)} {unit}".rstrip()
        is_mass = first.local == "point"
        titles[0] = f"a mass of about {size} left on" if is_mass else f"{titles[0]}, about {size}"
    said = listed(titles[:_MOST_CAUSES], "and" if found.claim == "pair" else "or")
    return f"{said}{', or another' if len(titles) > _MOST_CAUSES else ''}?"


def limit_step(result: BatchResult) -> str:
    """What can decide the first limit that is neither met nor missed; "" where there is none.

    Repeating the test does not help where a size of the plate dominates the standard deviation.
    """
    for limit in result.limits:
        for row in result.judged:
            p, constant = result.probability(row, limit), row.constant(limit.name)
            if p is None or constant is None or constant.is_open or not 1.0 - SURE < p < SURE:
                continue
            name, open_ = constant.decided_by, f"{limit.shown} is too close to call"
            if not name:
                return f"repeat the test of {row.name}: {open_}."
            how = "weigh" if name in ("mass", "density") else "gauge"
            return f"{how} {row.name} more accurately: its {name} dominates, a repeat does not help; {open_}."
    return ""


def certificate_section(result: BatchResult) -> Section:
    """Who tested each plate and when, and how the limits were judged; empty without limits.

    Entries common to all files are listed once.
    """
    if not result.limits:
        return Section(CERTIFICATE)
    read = tuple(row for row in result.rows if row.certificate)
    given = {name: {_stated(name, row) for row in read} for name in _STATED}
    rows = [(name, value) for name, values in given.items() if len(values) == 1 and (value := min(values))]
    differing = [Column(n, None, partial(_stated, n)) for n, values in given.items() if len(values) > 1]
    each = Rows("tests", (Column("plate", None, lambda row: row.name), *differing), read if differing else ())
    for row in result.rows:
        rows += [(f"list of {row.name}", remark) for remark in row.remarks]
        if row.all_rows:
            of_all = "; ".join(f"{c.name}: {c.text} {unit_of(c.name)}".rstrip() for c in row.all_rows)
            rows.append((f"{row.name} with all rows", of_all))
    rows += [(limit.shown, _guard(result, limit)) for limit in result.limits]
    rows += [
        ("pass", f"the probability of meeting every limit is {SURE:g} or more"),
        ("fail", f"that of one limit is {1.0 - SURE:.2g} or less"),
        ("too close to call", "between these: neither is shown"),
        ("cannot be judged", "the plate model does not describe the list, or the constant is left open"),
        ("computed by", f"cpam_bayes {__version__}, seed {result.seed}"),
    ]
    judged = facts("Test and acceptance criteria", rows)
    return Section(CERTIFICATE, (each.table("The test of each plate"), judged))


def _stated(name: str, row: PlateRow) -> str:
    """An entry of the plate file about its test; "" if missing."""
    return dict(row.certificate).get(name, "")


def _guard(result: BatchResult, limit: Limit) -> str:
    """The guard band of a limit: how far inside it a plate of typical sd passes."""
    sd = [c.sd for row in result.judged if (c := row.constant(limit.name)) is not None and not c.is_open]
    if not sd:
        return "judged for no plate"
    band = significant(to_user(limit.name, float(norm.ppf(SURE)) * float(np.median(sd))), 2)
    unit = unit_of(limit.name)
    return f"a guard band by probability: a plate passes {band} {unit}".rstrip() + " or more inside the limit"
