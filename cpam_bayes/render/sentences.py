"""Sentences and tables of several first screens: constants, fit, intervals, the next step."""

from __future__ import annotations

import math
import shlex
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
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

# Relative noise that is low for a tap test.
_GOOD = 0.003
# Misfit over the stated repeatability that is as good as it.
_AS_GOOD = 1.1
# Standard deviations of a reference from which on it does not decide a value.
_OFF_REFERENCE_SD: Final = 2.0
# Least visible fraction of an error of size that the frequencies are said to show.
_VISIBLE = 0.3
# Least relative error of a constant, for 1 % of a size, that is worth a word, %.
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
    """The value with its unit, to as many digits as its standard deviation is worth."""
    return _with_unit(c.name, _digits(c, c.value))


def interval_text(c: Constant) -> str:
    """The 95 % interval without its unit, "" where none can be given."""
    return "" if c.interval is None else " to ".join(_digits(c, end) for end in c.interval)


def determined_text(c: Constant) -> str:
    """The verdict on a constant in words: determined or not, and what else counts."""
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
        return f"partly: {_prior_counts(c)}"
    return f"determined, given the range of {listed(c.rests_on, 'and')}" if c.rests_on else "determined"


def constant_rows(constants: Sequence[Constant], name: str = "constants") -> Rows:
    """The constants of an answer as rows, in units of the plate file.

    name : of the CSV file and the data frame
    """
    return Rows(name, _CONSTANT, tuple(constants), lambda c: not c.is_determined)


def constants_table(constants: Sequence[Constant]) -> Table:
    """Name, value with unit, 95 % interval, determined or not."""
    return constant_rows(constants).table("")


def constant_details(
    constants: Sequence[Constant], material: Material | Hybrid, alone: Sequence[Constant] = ()
) -> Table:
    """Each constant in words, its standard deviation, reference and prior, and what decides its value.

    alone : the constants from the frequencies and bounds alone, where they have another prior
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
        Column("sd / prior's", None, share, number=True),
        Column("from the frequencies alone", None, lambda c: without.get(c.name)),
        Column("", None, lambda c: c.verdict.value),
    )
    rows = Rows("details", columns, tuple(constants), lambda c: not c.is_determined)
    return rows.table("Constants in detail")


def frequency_columns(rows: Sequence[FrequencyRow]) -> tuple[Column, ...]:
    """Mode, label, kind, measured and predicted frequency, residual."""
    return (
        Column("mode", None, lambda row: row.number or None, number=True),
        Column("label", "label", lambda row: row.label),
        Column("kind", "kind", lambda row: row.kind),
        *residual_columns(rows),
    )


def residual_columns(rows: Sequence[FrequencyRow]) -> tuple[Column, ...]:
    """Measured and predicted frequency, residual; as many decimals as were measured."""
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
    """Headline of the constants that the frequencies determine, and of those that they leave open."""
    determined = listed([c.name for c in constants if c.is_determined], "and")
    left = listed([c.name for c in constants if c.is_open], "or")
    subject = (
        "The frequency determines" if n_frequencies == 1 else f"The {n_frequencies} frequencies determine"
    )
    if not determined:
        return f"{subject} none of the constants."
    return f"{subject} {determined}{f', not {left}' if left else ''}."


def basis_error_text(error: float) -> str:
    """The largest relative error of a frequency by reduced bases, at draws of the answer."""
    return f"off by {significant(100 * error, 2)} % of a frequency at most, by full solves at draws"


def fit_sentence(
    rms: float,
    *,
    stated: float | None = None,
    measurement: Measurement | None = None,
    inferred: float | None = None,
    explained: bool = True,
    freedom: int | None = None,
) -> str:
    """How well the model fits, against the noise.

    rms : of the relative residuals. stated : relative noise of the measurement, which says what is in it.
    inferred : relative noise from the misfit, where none is stated. explained : whether the noise as stated
    explains the misfit. freedom : frequencies less constants.
    """
    fit = f"Fit {_percent(rms)} %"
    if stated is not None:
        level = _level(stated, measurement)
        if not explained:
            return f"{fit}, worse than {level}."
        if rms <= _AS_GOOD * stated:
            return f"{fit}, as good as {level}."
        return f"{fit}, {significant(rms / stated, 2)} times {level}."
    if inferred is not None and math.isfinite(inferred):
        high = ", high for a tap test" if inferred > USUAL_NOISE else ""
        return f"{fit}; noise estimated from it: {_percent(inferred)} %{high}."
    if freedom is not None and freedom <= 0:
        return f"{fit}, but as many constants as frequencies: nothing is left to estimate the noise by."
    return f"{fit}."


def intervals_sentence(
    plate: Plate,
    errors: Sequence[ScaleError],
    constants: Sequence[str],
    *,
    found: Collection[str] = (),
    also: Sequence[str] = (),
) -> str:
    """The contents of the intervals, and the largest error that they do not contain.

    constants : those worth a word. found : sizes whose error the model of the answer contains, beside those
    of [plate.sd]. also : what else the intervals contain, in words.
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
    # of equal ones the first, a size before the frequency scale
    most, number, constant = max(moved, key=lambda m: round(abs(m[0]), 1), default=(0.0, "", ""))
    if abs(most) < _WORTH_TELLING:
        return said
    return f"{said} Not contained: {_SCALE_WORDS[number]} (1 % more moves {constant} by {signed(most, 1)} %)."


def references_said(specimen: Specimen) -> tuple[str, ...]:
    """What is known before, as a part of what intervals contain; none where bounds alone count.

    A former plate's posterior, and the references in the prior: spreads that are assumed, and of which
    constants where [material.sd] gives those of others.
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
    """How far 1 % of each size, the mass and the frequency scale moves the constants.

    Their errors hardly show in the frequencies: the constants take them up.
    """
    columns = (
        Heading("if really 1 % more than stated"),
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
    return Table("What an error of a size does to the constants", columns, rows)


# What a balance tells.
_WEIGHED: Final = frozenset({"mass", "density"})


def gauge_step(specimen: Specimen, errors: Sequence[ScaleError], constants: Sequence[str]) -> tuple[str, ...]:
    """The numbers of the plate whose tolerances the plate file should state; none where they do no harm."""
    names = [
        "mass" if e.name == "density" and _densities_of_plies(specimen) else e.name
        for e in errors
        if e.name not in specimen.plate.sd and e.visible <= _VISIBLE and e.name != FREQUENCY_SCALE
        # per cent of a constant: by 1 % of the number, or by what is assumed of it
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
    return (f"state in the plate file how exactly {known}: {how}.",) if names else ()


def _digits(c: Constant, value: float) -> str:
    """A value of a constant in the unit of the plate file, to the digits of its standard deviation."""
    return with_spread(to_user(c.name, value), to_user(c.name, c.sd))[0]


def _with_unit(name: str, text: str) -> str:
    return f"{text} {unit_of(name)}".rstrip()


def _prior_counts(c: Constant) -> str:
    if c.has_former_plate:
        return "the former plate counts"
    kind, numbers = _prior_text(c.name, c.prior)
    if c.has_reference_prior:
        kind = "the data sheet's"
    return f"{kind} {numbers} {'count' if kind == 'bounds' else 'counts'}"


def _percent(relative: float) -> str:
    return significant(100.0 * relative, 2)


def _end(c: Constant, i: int) -> float | None:
    return None if c.interval is None else to_user(c.name, c.interval[i])


def constant_keys(c: Constant) -> dict[str, Any]:
    """A point estimate of a constant in a document, in units of the plate file."""
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
    """A constant in words, of a hybrid with its material; a name that has none stands for itself."""
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

    prior_of : a constant. shown : constants that are worth a word.
    """
    said = []
    for r in reliances:
        if r.name not in shown:
            continue
        kind, value = _prior_text(r.on, prior_of(r.on))
        said.append(
            f"The interval of {r.name} depends on the {kind} of {r.on}, {value}: twice as wide, it "
            f"would be {significant(100.0 * r.widening, 2)} % wider."
        )
    return tuple(said)


def reliance_table(
    reliances: Sequence[Reliance], prior_of: Callable[[str], Prior], shown: Sequence[str]
) -> Table:
    """The same as a list of remarks."""
    said = reliance_sentences(reliances, prior_of, shown)
    return remarks("Intervals that depend on the range of another constant", said)


def prior_text(name: str, prior: Prior) -> str:
    """The range of a prior, and centre and standard deviation where it has them, in the plate file's unit."""
    numbers = prior.describe(partial(to_user, name))
    span = f"{numbers.lower:.6g} to {numbers.upper:.6g}"
    return span if numbers.centre is None else f"{numbers.centre:.6g} +- {numbers.scale:.4g} in {span}"


def _prior_text(name: str, prior: Prior) -> tuple[str, str]:
    """The name of a prior, and its numbers in the unit of the plate file."""
    unit = f" {unit_of(name)}".rstrip()
    numbers = prior.describe(partial(to_user, name))
    if numbers.centre is None:
        return "bounds", f"{numbers.lower:.5g} to {numbers.upper:.5g}{unit}"
    return "prior", f"{numbers.centre:.5g} +- {numbers.scale:.3g}{unit}"


def further_steps(steps: Sequence[str]) -> Section:
    """The steps after the first one, which stands on the first screen."""
    return Section("Further steps", (remarks("Further steps", [f"{s[0].upper()}{s[1:]}" for s in steps]),))


def plate_argument(specimen: Specimen) -> str:
    """The plate as an argument of a command, quoted for a shell."""
    return shlex.quote(specimen.source.removeprefix("built-in "))


def attached_step(specimen: Specimen) -> tuple[str, ...]:
    """A question about masses on the plate, where the file gives none."""
    if specimen.sensors:
        return ()
    plate = specimen.plate
    percent = 0.1 / plate.total_mass
    return (
        "was an accelerometer, cable or tape on the plate? State it in the plate file: 1 g is "
        f"{significant(percent, 2)} % of the plate's mass and makes the moduli too low.",
    )


def diagnose_step(specimen: Specimen) -> str:
    """To ask what the model gets wrong."""
    return f"is anything wrong with the plate or the list?  cpam-bayes diagnose {plate_argument(specimen)}"


def more_modes_step(constants: Sequence[Constant]) -> tuple[str, ...]:
    """Further modes, which may determine the constants that the frequencies leave open."""
    left = listed([c.name for c in constants if not c.is_determined], "and")
    return (f"measure more modes: they may determine {left}.",) if left else ()


def correction_step(written: Iterable[str], of: Sequence[str] = ()) -> str:
    """To correct plate files without whose slips the lists fit.

    written : the files of `--out` that are corrected. of : names of the plates, where there are several
    """
    whose = f" of {listed(of, 'and')}" if of else ""
    files = listed([*written], "and")
    return f"correct the plate file{whose}{f', as in {files} in the directory of --out' if files else ''}."


def contradicts_itself(notices: Sequence[Notice]) -> bool:
    """Whether one of the notices says that what the file states of the plate cannot be."""
    return any(notice.code == "thicknesses_apart" for notice in notices)


def mismatch_step(
    specimen: Specimen, notices: Sequence[Notice], found: Sequence[str | None] = ()
) -> tuple[str, ...]:
    """The first check where the plate file contradicts itself, or the frequency list the plate.

    notices : of the answer. found : label of the mode that each frequency was paired with, None for no mode.
    """
    labels = () if specimen.measurement is None else specimen.measurement.labels
    other = [
        given
        for given, label in zip(labels, found, strict=False)
        if given and (label is None or same_label(given) != same_label(label))
    ]
    if contradicts_itself(notices):
        return ("gauge and weigh the plate again: its thickness, mass and density contradict one another.",)
    if not (contradicts_list(notices) or other):
        return ()
    edges = f"the edges ({edges_text(specimen.plate.edges)})"
    layup = () if specimen.material.isotropic else ("the layup",)
    named = ("the labels",) if any(labels) else ()
    what = listed([*named, edges, *layup, "the order and completeness of the list"], "and")
    return (f"check {what}: these frequencies contradict the plate model.",)


def noise_word(level: float) -> str:
    """How a relative noise compares with that of a tap test."""
    if level <= _GOOD:
        return "which is low for a tap test"
    return "which is usual for a tap test" if level <= USUAL_NOISE else "which is high for a tap test"


def stated_noise(measurement: Measurement) -> str:
    """What the noise of a measurement is made of."""
    if measurement.frequency_sd is None or not measurement.origin:
        return "as stated in the plate file"
    return measurement.sd_source


def _level(noise: float, measurement: Measurement | None) -> str:
    """The noise that a misfit is compared with: stated in the plate file, of the hits, or both."""
    level = f"{100.0 * noise:.2g} %"
    stated = None if measurement is None else measurement.relative_std
    is_stated = measurement is None or measurement.frequency_sd is None or not measurement.origin
    if measurement is None or is_stated or (stated is not None and f"{100.0 * stated:.2g} %" == level):
        return f"the stated repeatability of {level}"
    return f"{measurement.sd_source}, {level}{'' if stated is None else ' together'}"


def _densities_of_plies(specimen: Specimen) -> bool:
    """Whether the density of the plate follows from those of its materials."""
    return any(kind.density is not None for kind in specimen.plate.layup.kinds)
