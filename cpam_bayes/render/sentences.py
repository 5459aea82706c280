"""Sentences and tables shared by first screens: constants, fit, intervals, next step."""

from __future__ import annotations

import math
import shlex
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, Final

from cpam_bayes.answer import Constant, FrequencyRow, Notice, Reliance, Verdict
from cpam_bayes.formatting import NOT_KNOWN, decimals_of, fixed, listed, signed, significant, with_spread
from cpam_bayes.forward_model.known_errors import FREQUENCY_SCALE, ScaleError
from cpam_bayes.forward_model.labels import same_label
from cpam_bayes.forward_model.model import assumed_spreads
from cpam_bayes.forward_model.preconditions import USUAL_NOISE, contradicts_list
from cpam_bayes.plate import Hybrid, Material, Measurement, Plate, Specimen, split_name, to_user, unit_of
from cpam_bayes.plate.laminate import MaterialSymmetry
from cpam_bayes.priors import Prior
from cpam_bayes.render.plate import edges_text
from cpam_bayes.render.report import Column, Heading, Rows, Section, Table, remarks

_TITLES: Final = {
    "E1": "Young's modulus along the fibres",
    "E2": "Young's modulus across the fibres",
    "nu12": "Poisson's ratio in the ply",
    "G12": "shear modulus in the ply",
    "G13": "transverse shear modulus, along the fibres",
    "G23": "transverse shear modulus, across the fibres",
}
_ISOTROPIC: Final = {"E1": "Young's modulus", "nu12": "Poisson's ratio"}
_ORTHOTROPIC: Final = _TITLES | {
    "E1": "Young's modulus along axis 1 of the ply",
    "E2": "Young's modulus along axis 2 of the ply",
    "G13": "transverse shear modulus along axis 1",
    "G23": "transverse shear modulus along axis 2",
}
_TITLES_OF: Final[Mapping[MaterialSymmetry, Mapping[str, str]]] = {
    "isotropic": _ISOTROPIC,
    "transversely_isotropic": _TITLES,
    "orthotropic": _ORTHOTROPIC,
}

# Relative noise up to which a tap test is good.
_GOOD = 0.003
# Ratio of misfit to stated repeatability up to which the fit is as good as the repeatability.
_AS_GOOD = 1.1
# Standard deviations off the reference from which it does not decide a value.
_OFF_REFERENCE_SD: Final = 2.0
# Visible fraction of a size error above which the fit shows it.
_VISIBLE = 0.3
# Smallest shift of a constant, %, for 1 % of a size, that is reported.
_WORTH_TELLING = 0.3
_SCALE_WORDS: Final = {
    "thickness": "thickness",
    "length": "length",
    "width": "width",
    "density": "density",
    "mass": "mass",
    FREQUENCY_SCALE: "the analyser's frequency scale",
}


def value_text(c: Constant) -> str:
    """The value with its unit, to the digits of its standard deviation."""
    return _with_unit(c.name, _digits(c, c.value))


def interval_text(c: Constant) -> str:
    """The 95 % interval without its unit, "" where there is none."""
    return "" if c.interval is None else " to ".join(_digits(c, end) for end in c.interval)


def determined_text(c: Constant) -> str:
    """The verdict on a constant in words: determined or not, and why."""
    if c.bound is not None:
        return f"not determined: at its {c.bound} bound"
    if not math.isfinite(c.sd):
        return "uncertainty not known"
    if c.elsewhere:
        others = listed([_digits(c, value) for value in c.elsewhere], "or")
        return f"not determined: {others} fits as well"
    if c.verdict is Verdict.UNCONVERGED:
        return "not known: the chains did not converge"
    if c.verdict is Verdict.MISFIT:
        return "not determined: the model does not fit"
    if c.verdict is Verdict.PRIOR:
        if c.has_former_plate:
            return "not determined: the former plate decides"
        if not c.has_reference_prior:
            return "not determined"
        is_far = abs(c.value - c.reference) > _OFF_REFERENCE_SD * c.prior.sd
        return f"not determined: {'far from the data sheet' if is_far else 'the data sheet decides'}"
    if c.verdict is Verdict.BOTH:
        return f"partly, with {_prior_counts(c)}"
    return f"determined, given the range of {listed(c.rests_on, 'and')}" if c.rests_on else "determined"


def constant_rows(constants: Sequence[Constant], name: str = "constants") -> Rows:
    """Constants of an answer as rows, in plate-file units.

    name : of the CSV file and the data frame
    """
    at_bound = [c.name for c in constants if c.bound is not None and c.verdict is not Verdict.PRIOR]
    # the others depend on a bound that the frequencies push against
    rows = (
        replace(c, rests_on=(*at_bound, *(n for n in c.rests_on if n not in at_bound))) for c in constants
    )
    return Rows(name, _CONSTANT, tuple(rows), lambda c: not c.is_determined)


def constants_table(constants: Sequence[Constant]) -> Table:
    """Table of name, value with unit, 95 % interval, and whether determined."""
    return constant_rows(constants).table("")


def constant_details(
    constants: Sequence[Constant], material: Material | Hybrid, alone: Sequence[Constant] = ()
) -> Table:
    """Table of each constant in words, its standard deviation, reference, prior, and what decides its value.

    alone : constants from frequencies and bounds alone, where they have another prior
    """
    without = {c.name: f"{value_text(c)}, {interval_text(c)}" for c in alone}

    def sd(c: Constant) -> str:
        return _with_unit(c.name, with_spread(to_user(c.name, c.value), to_user(c.name, c.sd))[1])

    def share(c: Constant) -> str:
        return f"{100.0 * c.sd / c.prior.sd:.0f} %" if math.isfinite(c.sd) else NOT_KNOWN

    columns = (
        Column("", None, lambda c: c.name),
        Column("in words", None, lambda c: constant_title(c.name, material)),
        Column("value", None, value_text),
        Column("sd", None, sd),
        Column("reference", None, lambda c: to_user(c.name, c.reference), lambda v: f"{v:.6g}", number=True),
        Column("prior", None, lambda c: prior_text(c.name, c.prior)),
        Column("sd / prior sd", None, share, number=True),
        Column("from the frequencies alone", None, lambda c: without.get(c.name)),
        Column("", None, lambda c: c.verdict.value),
    )
    rows = Rows("details", columns, tuple(constants), lambda c: not c.is_determined)
    return rows.table("Constants in detail")


def frequency_columns(rows: Sequence[FrequencyRow]) -> tuple[Column, ...]:
    """Columns of mode, label, kind, measured and predicted frequency, residual."""
    return (
        Column("mode", None, lambda row: row.number or None, number=True),
        Column("label", "label", lambda row: row.label),
        Column("kind", "kind", lambda row: row.kind),
        *residual_columns(rows),
    )


def residual_columns(rows: Sequence[FrequencyRow]) -> tuple[Column, ...]:
    """Columns of measured and predicted frequency and residual, with the decimals of the measurement."""
    decimals = decimals_of(row.measured for row in rows if row.measured is not None)

    def finer(f: float) -> str:
        return fixed(f, decimals + 1)

    def residual(row: FrequencyRow) -> float | None:
        return None if row.residual is None else 100.0 * row.residual

    return (
        Column("measured Hz", "measured_hz", lambda row: row.measured, lambda f: fixed(f, decimals), True),
        Column("predicted Hz", "predicted_hz", lambda row: row.predicted, finer, True),
        Column("residual %", "residual_percent", residual, lambda r: signed(r, 2), True),
    )


def constants_headline(constants: Sequence[Constant], n_frequencies: int) -> str:
    """Headline: the constants that the frequencies determine, and those they leave open."""
    determined = listed([c.name for c in constants if c.is_determined], "and")
    left = listed([c.name for c in constants if c.is_open], "or")
    subject = (
        "The frequency determines" if n_frequencies == 1 else f"The {n_frequencies} frequencies determine"
    )
    if not determined:
        return f"{subject} none of the constants."
    return f"{subject} {determined}{f', not {left}' if left else ''}."


def basis_error_text(error: float) -> str:
    """Sentence on the largest relative error of a frequency by reduced bases, at draws of the answer."""
    return f"at most {significant(100 * error, 2)} % of a frequency off, by full solves at draws"


def fit_sentence(
    rms: float,
    *,
    stated: float | None = None,
    measurement: Measurement | None = None,
    inferred: float | None = None,
    explained: bool = True,
    freedom: int | None = None,
) -> str:
    """How well the model fits, compared with the noise.

    rms : of the relative residuals. stated : relative noise of the measurement, which names its source.
    inferred : relative noise from the misfit, where none is stated. explained : whether the stated noise
    explains the misfit. freedom : frequencies minus constants.
    """
    fit = f"Fit {_percent(rms)} %"
    if stated is not None:
        level = _level(stated, measurement)
        if rms <= _AS_GOOD * stated:
            far = "" if explained else ", but only far from stated sizes or constants"
            return f"{fit}, as good as {level}{far}."
        if not explained:
            return f"{fit}, worse than {level}."
        return f"{fit}, {significant(rms / stated, 2)} times {level}."
    if inferred is not None and math.isfinite(inferred):
        high = ", high for a tap test" if inferred > USUAL_NOISE else ""
        return f"{fit}; noise estimated from it: {_percent(inferred)} %{high}."
    if freedom is not None and freedom <= 0:
        return f"{fit}, but as many constants as frequencies: nothing is left to estimate the noise from."
    return f"{fit}."


def intervals_sentence(
    plate: Plate,
    errors: Sequence[ScaleError],
    constants: Sequence[str],
    *,
    found: Collection[str] = (),
    also: Sequence[str] = (),
) -> str:
    """Content of the intervals, and the largest error that they do not contain.

    constants : those to report. found : sizes whose error the model of the answer contains, beside those
    of [plate.sd]. also : further content of the intervals, in words.
    """
    within = {*(n for n, sd in plate.sd.items() if sd > 0.0), *found, *(e.name for e in errors if e.sd)}
    sizes = [words for name, words in _SCALE_WORDS.items() if name in within]
    said = f"The intervals contain {listed(['noise', *sizes, *also], 'and')}."
    moved = [
        (e.shift[name], e.name, name)
        for e in errors
        if e.sd is None and e.name not in found and e.visible <= _VISIBLE
        for name in constants
        if name in e.shift
    ]
    # of equal shifts the first, a size before the frequency scale
    most, number, constant = max(moved, key=lambda m: round(abs(m[0]), 1), default=(0.0, "", ""))
    if abs(most) < _WORTH_TELLING:
        return said
    return f"{said} Not contained: {_SCALE_WORDS[number]} (1 % more moves {constant} by {signed(most, 1)} %)."


def references_said(specimen: Specimen) -> tuple[str, ...]:
    """Prior knowledge in the intervals, in words; empty where bounds alone count.

    A former plate's posterior, and the references in the prior with their assumed spreads, by constant where
    [material.sd] gives those of others.
    """
    assumed = assumed_spreads(specimen)
    unknowns = specimen.unknowns.parameters
    known = [p.name for p in unknowns if not p.prior.is_range and p.coupled is None]
    former = ("the former plate",) if any(p.coupled is not None for p in unknowns) else ()
    if not assumed:
        return (*former, "the data sheet") if known else former
    each: dict[float, list[str]] = {}
    for name, spread in assumed.items():
        each.setdefault(spread, []).append(name)
    said = [f"{100.0 * spread:.2g} % assumed" for spread in each]
    if len(assumed) < len(known) or len(each) > 1:
        said = [f"{text} for {listed(names, 'and')}" for text, names in zip(said, each.values(), strict=True)]
    return (*former, f"the data sheet ({', '.join(said)})")


def errors_table(errors: Sequence[ScaleError], constants: Sequence[str]) -> Table:
    """Table of the shift of each constant by 1 % of each size, the mass and the frequency scale.

    Such errors hardly show in the frequencies: the constants absorb them.
    """
    columns = (
        Heading("if 1 % more than stated"),
        *(Heading(f"{name} %", number=True) for name in constants),
        Heading(),
    )
    rows = tuple(
        (
            _SCALE_WORDS[e.name],
            *(f"{e.shift[name]:+.1f}" if name in e.shift else "" for name in constants),
            "exact"
            if e.sd == 0.0
            else "in the intervals"
            if e.sd is not None
            else "shows in the fit"
            if e.visible > _VISIBLE
            else "",
        )
        for e in errors
    )
    return Table("Effect of 1 % errors on the constants", columns, rows)


# Numbers found by weighing.
_WEIGHED: Final = frozenset({"mass", "density"})


def gauge_step(specimen: Specimen, errors: Sequence[ScaleError], constants: Sequence[str]) -> tuple[str, ...]:
    """Next step: sizes whose tolerances the plate file should state; empty where they do no harm."""
    names = [
        "mass" if e.name == "density" and _densities_of_plies(specimen) else e.name
        for e in errors
        if e.name not in specimen.plate.sd and e.visible <= _VISIBLE and e.name != FREQUENCY_SCALE
        # shift of a constant, %: by 1 % of the size, or by its assumed sd
        if any(
            abs(e.shift.get(name, 0.0)) * (1.0 if e.sd is None else 100.0 * e.sd) >= _WORTH_TELLING
            for name in constants
        )
    ]
    known = f"{listed(names, 'and')} {'is' if len(names) == 1 else 'are'} known"
    verbs = [
        *(["gauge"] if set(names) - _WEIGHED else []),
        *(["weigh"] if set(names) & _WEIGHED else []),
    ]
    how = f"{' and '.join(verbs)} the plate"
    return (f"state in the plate file how accurately {known}: {how}.",) if names else ()


def _digits(c: Constant, value: float) -> str:
    """A value of a constant in plate-file units, to the digits of its standard deviation."""
    return with_spread(to_user(c.name, value), to_user(c.name, c.sd))[0]


def _with_unit(name: str, text: str) -> str:
    return f"{text} {unit_of(name)}".rstrip()


def _prior_counts(c: Constant) -> str:
    if c.has_former_plate:
        return "the former plate"
    kind, numbers = _prior_text(c.name, c.prior)
    if c.has_reference_prior:
        kind = "the data sheet's"
    return f"{kind} {numbers}"


def _percent(relative: float) -> str:
    return significant(100.0 * relative, 2)


def _end(c: Constant, i: int) -> float | None:
    return None if c.interval is None else to_user(c.name, c.interval[i])


def constant_keys(c: Constant) -> dict[str, Any]:
    """A point estimate of a constant in a document, in plate-file units."""
    return {
        "value": to_user(c.name, c.value),
        "sd": to_user(c.name, c.sd),
        "lower": to_user(c.name, c.prior.lower),
        "upper": to_user(c.name, c.prior.upper),
        "q025": _end(c, 0),
        "q975": _end(c, 1),
        "bound": c.bound,
        "verdict": c.verdict.value,
        "reference": to_user(c.name, c.reference),
    }


_CONSTANT: Final = (
    Column("", "name", lambda c: c.name),
    Column("value", None, value_text),
    Column("95 % interval", None, lambda c: interval_text(c) or None),
    Column("", None, determined_text),
    Column(None, "value", lambda c: to_user(c.name, c.value)),
    Column(None, "sd", lambda c: to_user(c.name, c.sd)),
    Column(None, "q025", lambda c: _end(c, 0)),
    Column(None, "q975", lambda c: _end(c, 1)),
    Column(None, "unit", lambda c: unit_of(c.name)),
    Column(None, "reference", lambda c: to_user(c.name, c.reference)),
    Column(None, "verdict", lambda c: c.verdict.value),
)


def constant_title(name: str, material: Material | Hybrid) -> str:
    """Title of a constant, for a hybrid with its material; a name without a title stays."""
    of, plain = split_name(name)
    part = material.parts.get(of)
    title = "" if part is None else _TITLES_OF[part.symmetry].get(plain, "")
    return (
        f"{title}{f', {part.name or of}' if of and part is not None else ''}"
        if title
        else _SCALE_WORDS.get(name, name)
    )


def reliance_sentences(
    reliances: Sequence[Reliance], prior_of: Callable[[str], Prior], shown: Sequence[str]
) -> tuple[str, ...]:
    """Sentences on how the prior of one constant widens the interval of another.

    prior_of : prior of a constant by name. shown : constants to report.
    """
    said = []
    for r in reliances:
        if r.name not in shown:
            continue
        kind, value = _prior_text(r.on, prior_of(r.on))
        said.append(
            f"The interval of {r.name} depends on the {kind} of {r.on}, {value}: twice that width makes it "
            f"{significant(100.0 * r.widening, 2)} % wider."
        )
    return tuple(said)


def reliance_table(
    reliances: Sequence[Reliance], prior_of: Callable[[str], Prior], shown: Sequence[str]
) -> Table:
    """Table of `reliance_sentences`."""
    said = reliance_sentences(reliances, prior_of, shown)
    return remarks("Intervals that depend on the range of another constant", said)


def prior_text(name: str, prior: Prior) -> str:
    """Range of a prior, with centre and standard deviation if any, in plate-file units."""
    numbers = prior.describe(partial(to_user, name))
    span = f"{numbers.lower:.6g} to {numbers.upper:.6g}"
    return span if numbers.centre is None else f"{numbers.centre:.6g} +- {numbers.scale:.4g} in {span}"


def _prior_text(name: str, prior: Prior) -> tuple[str, str]:
    """The kind of a prior, "bounds" or "prior", and its numbers in plate-file units."""
    unit = f" {unit_of(name)}".rstrip()
    numbers = prior.describe(partial(to_user, name))
    if numbers.centre is None:
        return "bounds", f"{numbers.lower:.5g} to {numbers.upper:.5g}{unit}"
    return "prior", f"{numbers.centre:.5g} +- {numbers.scale:.3g}{unit}"


def further_steps(steps: Sequence[str]) -> Section:
    """Section of the steps after the first, which is on the first screen."""
    return Section("Further steps", (remarks("Further steps", [f"{s[0].upper()}{s[1:]}" for s in steps]),))


def plate_argument(specimen: Specimen) -> str:
    """The plate as a command-line argument, quoted for a shell."""
    return shlex.quote(specimen.source.removeprefix("built-in "))


def attached_step(specimen: Specimen) -> tuple[str, ...]:
    """Question about attached masses, where the file has none."""
    if specimen.sensors:
        return ()
    plate = specimen.plate
    percent = 0.1 / plate.total_mass
    return (
        "was an accelerometer, cable or tape on the plate? State it in the plate file: 1 g is "
        f"{significant(percent, 2)} % of the plate's mass and makes the moduli too low.",
    )


def diagnose_step(specimen: Specimen) -> str:
    """Next step: diagnose the plate."""
    return f"is anything wrong with the plate or the list?  cpam-bayes diagnose {plate_argument(specimen)}"


def more_modes_step(constants: Sequence[Constant]) -> tuple[str, ...]:
    """Next step: measure further modes, which may determine open constants."""
    left = listed([c.name for c in constants if not c.is_determined], "and")
    return (f"measure more modes: they may determine {left}.",) if left else ()


def correction_step(written: Iterable[str], of: Sequence[str] = ()) -> str:
    """Next step: correct plate files whose slips explain the misfit.

    written : corrected files in `--out`. of : names of the plates, where there are several
    """
    whose = f" of {listed(of, 'and')}" if of else ""
    files = listed([*written], "and")
    return f"correct the plate file{whose}{f', as in {files} in the directory of --out' if files else ''}."


def bounds_step(notices: Sequence[Notice]) -> tuple[str, ...]:
    """Next step where the frequencies push constants against their bounds."""
    names = [name for n in notices if n.code == "at_bound" for name, *_ in n.facts["bounds"]]
    return (f"widen the bounds of {listed(names, 'and')} in [unknowns], and ask again.",) if names else ()


def contradicts_itself(notices: Sequence[Notice]) -> bool:
    """Whether a notice says that stated thickness, mass and density contradict each other."""
    return any(notice.code == "thicknesses_apart" for notice in notices)


def mismatch_step(
    specimen: Specimen, notices: Sequence[Notice], found: Sequence[str | None] = ()
) -> tuple[str, ...]:
    """Next step where the plate file contradicts itself, or the frequency list the plate.

    notices : of the answer. found : label of the mode paired with each frequency, None for no mode.
    """
    labels = () if specimen.measurement is None else specimen.measurement.labels
    other = [
        given
        for given, label in zip(labels, found, strict=False)
        if given and (label is None or same_label(given) != same_label(label))
    ]
    if contradicts_itself(notices):
        return ("gauge and weigh the plate again: its thickness, mass and density contradict one another.",)
    # what is off by little more than the noise may be a cause that `diagnose` names
    if not (contradicts_list(n for n in notices if n.code != "misfit_over_noise") or other):
        return ()
    edges = f"the edges ({edges_text(specimen.plate.edges)})"
    layup = () if specimen.material.isotropic else ("the layup",)
    grid = ("the grid of angles",) if specimen.plate.layup.n_unknown else ()
    named = ("the labels",) if any(labels) else ()
    what = listed([*named, edges, *layup, *grid, "the order and completeness of the list"], "and")
    return (f"check {what}: these frequencies contradict the plate model.",)


def noise_word(level: float) -> str:
    """A relative noise compared with that of a tap test, in words."""
    if level <= _GOOD:
        return "which is low for a tap test"
    return "which is usual for a tap test" if level <= USUAL_NOISE else "which is high for a tap test"


def stated_noise(measurement: Measurement) -> str:
    """Source of the noise of a measurement, in words."""
    if measurement.frequency_sd is None or not measurement.origin:
        return "as stated in the plate file"
    return measurement.sd_source


def _level(noise: float, measurement: Measurement | None) -> str:
    """The noise that a misfit is compared with: stated in the plate file, from the hits, or both."""
    level = f"{100.0 * noise:.2g} %"
    stated = None if measurement is None else measurement.relative_std
    is_stated = measurement is None or measurement.frequency_sd is None or not measurement.origin
    if measurement is None or is_stated or (stated is not None and f"{100.0 * stated:.2g} %" == level):
        return f"the stated repeatability of {level}"
    return f"{measurement.sd_source}, {level}{'' if stated is None else ' together'}"


def _densities_of_plies(specimen: Specimen) -> bool:
    """Whether the density of the plate follows from those of its materials."""
    return any(kind.density is not None for kind in specimen.plate.layup.kinds)
