"""A diagnosis in workshop units and words: its rows, short texts, and JSON document."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Final

import numpy as np
from numpy.typing import NDArray

from cpam_bayes import __version__
from cpam_bayes.answer import Constant
from cpam_bayes.answer import FrequencyRow as AnswerRow
from cpam_bayes.diagnosis.diagnose import Cause, Diagnosis
from cpam_bayes.diagnosis.evidence.marginal import Tested, distinct_hypotheses, prior_of
from cpam_bayes.diagnosis.extension import FrequencyRow, PairedFit
from cpam_bayes.diagnosis.fit import Fit, inferred_noise
from cpam_bayes.diagnosis.hypotheses import NONE, OTHER, SET, Claim, Hypothesis, causes_in
from cpam_bayes.diagnosis.next_test import Candidate
from cpam_bayes.diagnosis.places import images_of
from cpam_bayes.effects import CATALOGUE, Effect, scale_of
from cpam_bayes.formatting import fixed, signed, significant, with_spread
from cpam_bayes.forward_model.model import reference_constants
from cpam_bayes.identification.point import verdict_of
from cpam_bayes.parameters import Parameter, Prior
from cpam_bayes.plate import Plate, to_user, user_name
from cpam_bayes.questions.identify.slips import pushed
from cpam_bayes.render.report import Column, Rows
from cpam_bayes.render.spectrum import peak_keys, peak_rows
from cpam_bayes.result import PlatesResult

Moments = tuple[float, float, float, float]
"""Mean, standard deviation, 2.5 % and 97.5 % quantile."""

_SCALES: Final = ("scales_times_3", "scales_divided_by_3")
"""Keys of the answers with rescaled priors."""
FEW: Final = 3
"""Most names listed in a sentence."""
# A standard deviation below this fraction of its mean is not shown.
_UNSURE: Final = 1e-3


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class DiagnosisResult(PlatesResult):
    """Weighed causes, the claim, the extended model and its gain.

    Attributes
    ----------
    diagnosis : claim, causes with their probabilities, both fits, gain
    air_shifts : for each plate, see `PlateResult.air_shifts`
    plain, extended : each measured frequency with its mode; extended is None where nothing is claimed
    mode_shapes : for each plate, u, v, w on a regular grid, (n_modes, 3, n, n), by the plain model at its
        most probable constants
    scatter : relative standard deviation of a constant from plate to plate
    candidates : further tests, the most informative first
    """

    command: ClassVar[str] = "diagnose"

    diagnosis: Diagnosis
    air_shifts: tuple[NDArray[np.float64] | None, ...]
    plain: PairedFit
    extended: PairedFit | None
    mode_shapes: tuple[NDArray[np.float64], ...]
    scatter: float
    candidates: tuple[Candidate, ...] = ()

    @property
    def claim(self) -> str:
        """One of "none", "named", "class", "pair", "other" and "undecided"."""
        return self.diagnosis.claim.kind

    @property
    def causes(self) -> tuple[str, ...]:
        """Names of the claimed causes."""
        return self.diagnosis.claim.causes

    @property
    def probability(self) -> float:
        """Probability of the claim."""
        return self.diagnosis.claim.probability


@dataclass(frozen=True, slots=True)
class DetectableRow:
    """The detection limit of one cause.

    title : the cause in words
    smallest : size in ``unit``, None where none would have been claimed
    in_sd : the same in standard deviations of the catalogue
    probability : of a claim at that size, or at the best one; None for a cause without a size
    """

    cause: str
    title: str
    smallest: float | None
    unit: str | None
    in_sd: float | None
    probability: float | None


def detectable_rows(d: Diagnosis) -> tuple[DetectableRow, ...]:
    """Detection limits of all tested causes, in workshop units."""
    titles = titles_of(cause.hypothesis for cause in d.causes)
    rows = []
    for entry in d.detectable:
        p, smallest, in_sd, unit = entry.parameter, None, None, None
        if p is not None:
            unit, factor = p.display
            if entry.smallest is not None:
                smallest, in_sd = factor * entry.smallest, entry.smallest / scale_of(p)
        title = titles.get(entry.cause, entry.cause)
        rows.append(DetectableRow(entry.cause, title, smallest, unit, in_sd, entry.probability_of_claim))
    return tuple(rows)


def titles_of(hypotheses: Iterable[Hypothesis]) -> dict[str, str]:
    """Name of a single cause -> its title, from the catalogue and the hypotheses."""
    tested = (effect for hypothesis in hypotheses for effect in hypothesis.records)
    effects = {effect.name: effect.title for effect in (*CATALOGUE, *tested)}
    return effects | {NONE: "nothing wrong", OTHER: "an unknown error"}


def leading(d: Diagnosis, least: float, most: int) -> tuple[Cause, ...]:
    """Causes to show: the most probable ones, and always none and other."""
    shown = []
    for rank, cause in enumerate(d.causes):
        if cause.name in (NONE, OTHER) or (rank < most and (cause.probability >= least or rank < 6)):
            shown.append(cause)
    return tuple(shown)


def some_of(names: Sequence[str]) -> str:
    """The first names, and how many more there are."""
    more = f" and {len(names) - FEW} more" if len(names) > FEW else ""
    return ", ".join(names[:FEW]) + more


def title_of(d: Diagnosis, name: str) -> str:
    """Title of a cause; a pair has both."""
    titles = titles_of(cause.hypothesis for cause in d.causes)
    return " and ".join(titles.get(part, part) for part in causes_in(name))


def probability_text(p: float) -> str:
    """A probability with two or three decimals."""
    if p < 0.0005:
        return "< 0.001"
    return "> 0.999" if p > 0.9995 else fixed(p, 3 if p < 0.1 or p > 0.9 else 2)


def detectable_size(row: DetectableRow) -> str:
    """The smallest size that would have been claimed, with its unit."""
    if row.smallest is None:
        return "at no size" if row.probability is not None else "has no size"
    return f"{significant(row.smallest, 2)} {row.unit or ''}".rstrip()


def size_text(cause: Cause, effects: Sequence[Effect] | None = None) -> str:
    """Sizes of a cause, mean and sd with unit; effects : of a pair, those to show."""
    chosen = cause.hypothesis.records if effects is None else effects
    names = {p.name for e in chosen for p in e.sizes}
    sizes = []
    for parameter in cause.hypothesis.parameters:
        if parameter.name not in names:
            continue
        mean, sd, _ = cause.parameters[parameter.name]
        sizes.append(_with_unit(parameter, mean, sd))
    return "; ".join(sizes)


def place_text(cause: Cause, plate: Plate) -> str:
    """Place of a cause, mm, and its other coordinates; "" for a cause without a place."""
    found = []
    place = place_of(cause, plate)
    if place is not None:
        (x, y), spread = place
        found.append(f"({1e3 * x:.0f}, {1e3 * y:.0f}) mm, +- {1e3 * max(spread):.0f} mm")
    known = () if place is None else _place_names(cause)
    for parameter in (p for e in cause.hypothesis.records for p in e.coordinates):
        if parameter.name not in known:
            mean, sd, _ = cause.parameters[parameter.name]
            said = parameter.name.rsplit("_", 1)[-1] if parameter.display[0] != "deg" else "direction"
            found.append(f"{_WORDS.get(said, said)} {_with_unit(parameter, mean, sd)}")
    return "; ".join(found)


_WORDS: Final = {"gyration": "radius of gyration"}


def place_of(
    cause: Cause, plate: Plate, effect: Effect | None = None
) -> tuple[tuple[float, float], tuple[float, float]] | None:
    """Place of a cause, x and y with their standard deviations, m; None for a cause without a single place.

    effect : one of the cause's effects; if None the first that has a place
    """
    names = _place_names(cause, effect)
    if not names:
        return None
    (x, sd_x, _), (y, sd_y, _) = (cause.parameters[name] for name in names)
    a, b = plate.length, plate.width
    return (a * x, b * y), (a * sd_x, b * sd_y)


def places_of(d: Diagnosis, cause: Cause, effect: Effect | None = None) -> tuple[tuple[float, float], ...]:
    """Place of an effect and its images, which no frequency distinguishes, m; empty without a place.

    effect : as in `place_of`
    """
    models = [case.models for case in d.cases if case.name in cause.plates]
    plate = models[0].specimen.plate
    place = place_of(cause, plate, effect)
    if place is None:
        return ()
    a, b = plate.length, plate.width
    (x, y), (sd_x, sd_y) = place
    every = images_of((x / a, y / b), [m.facts for m in models], (sd_x / a, sd_y / b))
    return ((x, y), *((a * u, b * v) for u, v in every[1:]))


def _place_names(cause: Cause, effect: Effect | None = None) -> tuple[str, ...]:
    """Names of the x and y parameters of an effect that may be anywhere, the first one if None."""
    anywhere = (e for e in cause.hypothesis.records if e.is_anywhere and effect in (None, e))
    return next((tuple(p.name for p in e.coordinates[:2]) for e in anywhere), ())


def _with_unit(parameter: Parameter, mean: float, sd: float) -> str:
    shown, factor = parameter.display
    if sd < _UNSURE * abs(mean):  # one node holds all the weight
        return f"about {significant(factor * mean, 2)} {shown}".rstrip()
    value, spread = with_spread(factor * mean, factor * sd)
    return f"{value} +- {spread} {shown}".rstrip()


def answer_constants(d: Diagnosis) -> tuple[Constant, ...]:
    """The answer: the constants shared by all plates, averaged over all hypotheses."""
    return _constants_of(d, d.averaged, explained=d.explained)


def fit_constants(d: Diagnosis, fit: Fit) -> tuple[Constant, ...]:
    """The constants shared by all plates, from one fit."""
    return _constants_of(d, fit.constants, explained=_explained(d, fit))


def _plate_constants(d: Diagnosis, fit: Fit, i: int) -> tuple[Constant, ...]:
    """The constants of one plate, with its own deviations from the shared ones."""
    case, names = d.cases[i], list(fit.constants)
    own: dict[str, Moments] = {}
    for name in case.models.specimen.unknowns.names:
        if name not in names:
            continue
        draws = fit.draws[:, names.index(name)]
        for column, p in enumerate(fit.parameters.values()):
            if (p.kind, p.base, p.of) == ("scatter", name, case.models.specimen.specimen):
                draws = draws * (1.0 + fit.draws[:, column])
        low, high = np.quantile(draws, (0.025, 0.975))
        own[name] = (float(draws.mean()), float(draws.std()), float(low), float(high))
    return _constants_of(d, own, explained=_explained(d, fit))


def _explained(d: Diagnosis, fit: Fit) -> bool:
    return d.plain_explained if fit is d.baseline else d.explained


def _constants_of(d: Diagnosis, moments: Mapping[str, Moments], *, explained: bool) -> tuple[Constant, ...]:
    found = []
    for name, (mean, sd, low, high) in moments.items():
        case = next((c for c in d.cases if name in c.models.specimen.unknowns.names), None)
        if case is None:
            continue
        parameter = case.models.parameters[name]
        prior = parameter.prior
        constant = pushed(
            Constant(
                name,
                mean,
                sd,
                (low, high),
                prior,
                float(reference_constants(case.models.specimen).get(name, float("nan"))),
                verdict_of(sd, prior.sd, explained=explained),
                rests_on=tuple(r.on for r in d.reliances if r.name == name),
                has_former_plate=parameter.coupled is not None,
            )
        )
        found.append(constant)
    return tuple(found)


def _nuisance_of(d: Diagnosis, fit: Fit) -> dict[str, tuple[float, float]]:
    """Mean and sd of sizes and plate-to-plate deviations, sizes with plate-file unit and name."""
    constants = {c.name for c in fit_constants(d, fit)}
    nuisance = {}
    for name, (mean, sd, _, _) in fit.constants.items():
        if name in constants:
            continue
        parameter = fit.parameters[name]
        if parameter.kind == "scatter":
            nuisance[name] = (mean, sd)
            continue
        base = parameter.own
        shown = user_name(base) + (f" of {parameter.of}" if parameter.of else "")
        nuisance[shown] = (to_user(base, mean), to_user(base, sd))
    return nuisance


def catalogue_sd(cause: Cause) -> float:
    """One catalogue standard deviation of a cause's first parameter, in its display unit."""
    parameter = cause.hypothesis.parameters[0]
    return float(f"{scale_of(parameter) * parameter.display[1]:.6g}")


def absorbed_biases(d: Diagnosis, cause: Cause) -> tuple[float, str, dict[str, float]]:
    """First-order bias of the constants by a cause that is not modelled.

    Size of the effect and its unit as shown, and by constant the change in % per unit.
    """
    parameter, *_ = cause.hypothesis.parameters
    mean, sd, _ = cause.parameters[parameter.name]
    shown, factor = parameter.display
    # the size at which the signature was taken
    size = float(np.hypot(mean, sd)) * (-1.0 if mean < 0.0 else 1.0) * factor
    unknowns = {name for case in d.cases for name in case.models.specimen.unknowns.names}
    names = [n for n in cause.bias if n in unknowns]
    if size == 0.0:
        return 0.0, shown, {}
    return size, shown, {user_name(n): 100.0 * cause.bias[n] / size for n in names}


_CONSTANT: Final = (
    Column(None, "name", lambda c: user_name(c.name)),
    Column(None, "mean", lambda c: to_user(c.name, c.value)),
    Column(None, "sd", lambda c: to_user(c.name, c.sd)),
    Column(None, "q025", lambda c: to_user(c.name, c.interval[0])),
    Column(None, "q975", lambda c: to_user(c.name, c.interval[1])),
    Column(None, "prior_contraction", lambda c: 1.0 - (c.sd / c.prior.sd) ** 2),
    Column(None, "reference", lambda c: to_user(c.name, c.reference)),
)


def _paired(value: Callable[[FrequencyRow], float]) -> Callable[[FrequencyRow], float | None]:
    """A value of a frequency that is paired with a mode, else None."""
    return lambda row: None if row.predicted is None else value(row)


_FREQUENCY: Final = (
    Column(None, "plate", lambda r: r.plate),
    Column(None, "measured_hz", lambda r: r.measured),
    Column(None, "predicted_hz", lambda r: r.predicted),
    Column(None, "predicted_sd_hz", _paired(lambda r: r.predicted_sd)),
    Column(None, "noise_sd_hz", _paired(lambda r: r.sigma)),
    Column(None, "residual_percent", lambda r: r.residual_percent),
    Column(None, "standardised", _paired(lambda r: r.standardised)),
    Column(None, "kind", lambda r: None if r.mode is None else r.mode.kind),
    Column(None, "label", lambda r: None if r.mode is None else r.mode.label),
)
_MISSED: Final = (
    Column(None, "plate", lambda m: m.plate),
    Column(None, "predicted_hz", lambda m: m.mode.frequency),
    Column(None, "kind", lambda m: m.mode.kind),
    Column(None, "label", lambda m: m.mode.label),
)
_DETECTABLE: Final = (
    Column(None, "cause", lambda r: r.cause),
    Column("error", None, lambda r: r.title),
    Column("smallest size that shows", None, lambda r: r.smallest and detectable_size(r), number=True),
    Column("in assumed sd", None, lambda r: r.in_sd, lambda v: significant(v, 2), True),
    Column(None, "smallest", lambda r: r.smallest),
    Column(None, "unit", lambda r: r.unit),
    Column(
        "detection probability", "probability_of_claim", lambda r: r.probability, lambda p: fixed(p, 2), True
    ),
)
_CANDIDATE: Final = (
    Column(None, "name", lambda c: c.name),
    Column("test", "description", lambda c: c.description),
    Column("information, nats", "information_nats", lambda c: c.information, lambda v: fixed(v, 2), True),
    Column("at most, nats", "possible_nats", lambda c: c.possible, lambda v: fixed(v, 2), True),
    Column("decides", "probability_decided", lambda c: c.decided, lambda p: f"{100 * p:.0f} %", True),
)


def _hypothesis_columns(d: Diagnosis) -> tuple[Column, ...]:
    plates = {case.name: case.models.specimen.plate for case in d.cases}
    scales = dict(zip(_SCALES, d.sensitivity.probabilities, strict=True))
    larger, smaller = d.sensitivity.probabilities

    def prior(cause: Cause) -> float:
        return prior_of([t for t in d.weighed.tested if t.hypothesis.cause == cause.name])

    def size(cause: Cause) -> str:
        text = size_text(cause)
        return f"{text} (hidden)" if cause.absorbed and text else text

    def where(cause: Cause) -> str | None:
        if cause.name in (NONE, OTHER):
            return None
        at = place_text(cause, plates[cause.plates[0]]) if cause.plates else ""
        return "; ".join(t for t in (at, cause.variant) if t)

    def places(cause: Cause) -> dict[str, list[list[float]]]:
        effects = [e for e in cause.hypothesis.records if e.is_anywhere]
        return {e.name: [[1e3 * x, 1e3 * y] for x, y in places_of(d, cause, e)] for e in effects}

    def of(cause: Cause) -> str | None:
        if len(d.cases) == 1 or cause.name in (NONE, OTHER):
            return None
        return "all" if len(cause.plates) == len(d.cases) else ", ".join(cause.plates)

    return (
        Column("cause", "cause", lambda c: c.name, lambda name: title_of(d, name)),
        Column("size, mean and sd", None, size),
        Column("where", None, where),
        Column("of", None, of),
        Column("probability", "probability", lambda c: c.probability, probability_text, True),
        Column(
            None, "probability_range", lambda c: {key: of_cause[c.name] for key, of_cause in scales.items()}
        ),
        Column("errors x 3", None, lambda c: larger[c.name], probability_text, True),
        Column("errors / 3", None, lambda c: smaller[c.name], probability_text, True),
        Column(
            "log Bayes factor", "log_bayes_factor", lambda c: c.log_bayes_factor, lambda v: signed(v, 1), True
        ),
        Column(None, "log_evidence_error", lambda c: c.log_evidence_error),
        Column(None, "k_hat", lambda c: c.k_hat),
        Column(None, "parameters", lambda c: {p.name: _size(p, c) for p in c.hypothesis.parameters}),
        Column(None, "places_mm", places),
        Column(
            "indistinguishable from",
            "indistinguishable_from",
            lambda c: list(c.indistinguishable_from),
            lambda names: some_of([title_of(d, name) for name in names]),
        ),
        Column(None, "max_shift_percent", lambda c: 100.0 * c.max_shift),
        Column(None, "leftover_percent", lambda c: 100.0 * c.leftover),
        Column(None, "variant", lambda c: c.variant or None),
        Column(None, "plates", lambda c: list(c.plates)),
        Column(None, "absorbed", lambda c: c.absorbed),
        Column(None, "visible_share", lambda c: c.visible),
        Column(None, "prior", prior),
    )


def _size(parameter: Parameter, cause: Cause) -> dict[str, Any]:
    mean, sd, _ = cause.parameters[parameter.name]
    shown, factor = parameter.display
    return {"mean": factor * mean, "sd": factor * sd, "unit": shown}


def tables(result: DiagnosisResult) -> tuple[Rows, ...]:
    """Tables of a diagnosis for CSV files and data frames, hypotheses first."""
    d = result.diagnosis
    fit = result.plain if result.extended is None else result.extended
    return (
        Rows("hypotheses", _hypothesis_columns(d), d.causes),
        Rows("constants", _CONSTANT, answer_constants(d)),
        Rows("frequencies", _FREQUENCY, fit.frequencies),
        Rows("detectable", _DETECTABLE, detectable_rows(d)),
        Rows("next_measurement", _CANDIDATE, result.candidates),
        *((peaks,) if (peaks := taken_peaks(result)).rows else ()),
    )


def taken_peaks(result: DiagnosisResult) -> Rows:
    """Candidate peaks with their modes; empty for lists and for several plates."""
    fit = result.plain if result.extended is None else result.extended
    several = len(result.plates) > 1
    rows = (
        AnswerRow(r.measured, r.predicted, None, r.mode.label, r.number or 0)
        for r in fit.frequencies
        if r.mode is not None
    )
    return peak_rows(None if several else result.plates[0].measurement, rows)


def document(result: DiagnosisResult, sentence: str) -> dict[str, Any]:
    """The JSON document of `diagnose`; sentence : the claim in words."""
    d, specimens = result.diagnosis, result.plates
    plates = [{"plate": s.name, "specimen": s.specimen, "source": s.source} for s in specimens]
    head = {"command": result.command, "version": __version__, "seed": result.seed}
    if len(plates) == 1:
        head |= plates[0]
    records = {rows.name: rows.records() for rows in tables(result)}
    answer = _constants(answer_constants(d))
    return {
        **head,
        "plates": plates,
        "claim": d.claim.kind,
        "causes": list(d.claim.causes),
        "probability": d.claim.probability,
        "sentence": sentence,
        "something_wrong": d.something_wrong,
        "inclusion": dict(d.inclusion),
        "constants": answer,
        "claim_stands": d.sensitivity.claim_stands,
        "unaccounted_probability": d.weighed.unaccounted,
        "claims_by_prior_scales": dict(zip(_SCALES, map(_claim, d.sensitivity.claims), strict=True)),
        "hypotheses": records["hypotheses"],
        "baseline": _fit(d, d.baseline, d.weighed.plain, result.plain),
        "extended": _extended(result),
        "averaged": answer,
        "optima": [
            {
                "probability": o.fraction,
                "constants": {
                    user_name(n): to_user(n, o.constants[n]) for n in d.averaged if n in o.constants
                },
                "modes": [list(labels) for labels in o.modes],
            }
            for o in d.optima
        ],
        "gain": _gain(d),
        "detectable": records["detectable"],
        "tested": {"hypotheses": len(d.weighed.tested), "causes": list(d.tested_causes)},
        "next_measurement": records["next_measurement"],
        "absorbed": [_absorbed(d, cause) for cause in d.hidden_causes],
        "not_tested": list(d.weighed.not_tested),
        "priors": _priors(d),
        "material_scatter": result.scatter if len({s.specimen for s in specimens}) > 1 else None,
        "air_density_kg_m3": {s.name: s.air_density for s in specimens},
        "basis_error": d.basis_error,
        **peak_keys(taken_peaks(result)),
        "seconds": d.seconds,
        "warnings": list(result.warnings),
        "notes": [note for s in specimens for note in s.notes],
    }


def _claim(claim: Claim) -> dict[str, Any]:
    return {"claim": claim.kind, "causes": list(claim.causes), "probability": claim.probability}


def _extended(result: DiagnosisResult) -> dict[str, Any] | None:
    d = result.diagnosis
    if d.extended is None or result.extended is None:
        return None
    return {
        **_fit(d, d.extended, d.members, result.extended),
        "members": [
            {
                "cause": t.hypothesis.cause,
                "variant": t.hypothesis.variant or None,
                "plates": [d.cases[i].name for i in t.plates],
                "share": weight,
            }
            for t, weight in d.members
        ],
    }


def _fit(
    d: Diagnosis, fit: Fit, members: Sequence[tuple[Tested, float]], paired: PairedFit
) -> dict[str, Any]:
    """One fit; for several plates also by plate."""
    rows = paired.frequencies
    noise = inferred_noise(members)
    keys: dict[str, Any] = {
        "constants": _constants(fit_constants(d, fit)),
        "frequencies": _frequencies(rows),
        "rms_percent": 100.0 * fit.rms,
        "rms_as_stated_percent": 100.0 * fit.rms_as_stated,
        "log_evidence": fit.log_evidence,
        "log_evidence_error": fit.log_evidence_error,
        "k_hat": fit.k_hat,
        "posterior_predictive_p_value": fit.p_value,
        "predictive_p": fit.predictive_p,
        "noise_percent": None if noise is None else {"mean": 100.0 * noise[0], "sd": 100.0 * noise[1]},
        "nuisance": {name: {"mean": mean, "sd": sd} for name, (mean, sd) in _nuisance_of(d, fit).items()},
        "missed_modes": Rows("missed_modes", _MISSED, paired.missed).records(),
    }
    if len(d.cases) > 1:
        keys["plates"] = [_plate(d, fit, i, rows) for i in range(len(d.cases))]
    return keys


def _plate(d: Diagnosis, fit: Fit, i: int, rows: Sequence[FrequencyRow]) -> dict[str, Any]:
    """One plate of several; the evidence is of all lists together, which share the constants."""
    name = d.cases[i].name
    plate_rows = [row for row in rows if row.plate == name]
    squares = [row.residual_percent**2 for row in plate_rows if row.residual_percent is not None]
    return {
        "plate": name,
        "constants": _constants(_plate_constants(d, fit, i)),
        "frequencies": _frequencies(plate_rows),
        "rms_percent": (sum(squares) / len(squares)) ** 0.5 if squares else 0.0,
        "log_evidence": fit.log_evidence,
        "log_evidence_of": "all plates together",
    }


def _constants(constants: Sequence[Constant]) -> dict[str, Any]:
    records = Rows("constants", _CONSTANT, tuple(constants)).records()
    return {record.pop("name"): record for record in records}


def _frequencies(rows: Sequence[FrequencyRow]) -> list[dict[str, Any]]:
    return Rows("frequencies", _FREQUENCY, tuple(rows)).records()


def _gain(d: Diagnosis) -> dict[str, Any] | None:
    gain = d.gain
    if gain is None:
        return None
    return {
        "rms_percent_before": 100.0 * gain.rms_before,
        "rms_percent_after": 100.0 * gain.rms_after,
        "log_bayes_factor": gain.log_bayes_factor,
        "held_out_log_score_difference": gain.held_out_difference,
        "held_out_log_score_se": gain.held_out_se,
        "held_out_log_score_by_frequency": gain.held_out.tolist(),
        "held_out_hypotheses": gain.n_hypotheses,
        "stable_share": gain.stable,
    }


def _absorbed(d: Diagnosis, cause: Cause) -> dict[str, Any]:
    size, unit, per_unit = absorbed_biases(d, cause)
    return {
        "cause": cause.name,
        "visible_share": cause.visible,
        "absorbed": cause.absorbed,
        "unit": unit,
        "bias_percent_per_unit": per_unit,
        "bias_percent": {name: size * value for name, value in per_unit.items()},
        "at": size,
    }


def _priors(d: Diagnosis) -> dict[str, Any]:
    """Prior probabilities of families and causes, and the priors of effect sizes."""
    families: dict[str, dict[str, float]] = defaultdict(lambda: defaultdict(float))
    effects: dict[str, dict[str, Any]] = {}
    of_sets = 0.0
    for h in distinct_hypotheses(d.weighed.tested):
        if h.family == SET:
            of_sets += h.prior
            continue
        if h.cause not in (NONE, OTHER):
            families[h.family][h.cause] += h.prior
        for p in h.parameters:
            wide = f"{h.cause} gross" if h.is_gross else h.cause
            effects.setdefault(wide, {})[p.name] = _effect_prior(p)
    return {
        "none": d.weighed.none.hypothesis.prior,
        "other": prior_of([t for t in d.weighed.tested if t.hypothesis.cause == OTHER]),
        "sets_tested": of_sets,
        "families": {name: dict(causes) for name, causes in families.items()},
        "effects": effects,
    }


def _effect_prior(p: Parameter) -> dict[str, Any]:
    """The prior of a size: its tolerance, and its gross error if it has one."""
    unit, factor = p.display
    (_, tolerance), *gross = p.prior.parts
    return {
        "mean": factor * p.prior.mean,
        **_density(tolerance, factor),
        "gross": {"fraction": gross[0][0], **_density(gross[0][1], factor)} if gross else None,
        "lower": factor * p.prior.lower,
        "upper": factor * p.prior.upper,
        "unit": unit,
    }


def _density(prior: Prior, factor: float) -> dict[str, Any]:
    numbers = prior.describe(lambda value: factor * value)
    # a density about zero by its scale before truncation, any other by its standard deviation
    return {"kind": numbers.kind, "scale": numbers.sd if numbers.centre else numbers.scale}
