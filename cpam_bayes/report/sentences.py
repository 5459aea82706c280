"""Sentences that the summaries of several questions share; each can be understood alone."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Final

from cpam_bayes.formatting import fixed, listed, significant
from cpam_bayes.forward_model.labels import same_label
from cpam_bayes.forward_model.slips import contradicts_list
from cpam_bayes.identification.reliance import Reliance
from cpam_bayes.identification.scale_errors import FREQUENCY_SCALE, ScaleError
from cpam_bayes.identification.verdicts import MISFIT, Verdict
from cpam_bayes.plate import Hybrid, Material, Measurement, Plate, Specimen, to_user, unit_of, user_name
from cpam_bayes.plate.elasticity import MaterialSymmetry
from cpam_bayes.plate.units import split_name
from cpam_bayes.priors import Prior, TruncatedNormal
from cpam_bayes.report.plates.head import edges_text, layup_text, size_text
from cpam_bayes.report.summary import Determined

__all__ = [
    "CONTAINED",
    "DETERMINED",
    "HIGH_NOISE",
    "UNDESCRIBED",
    "attached_step",
    "constant_title",
    "contained_sentence",
    "decider",
    "diagnose_step",
    "frequencies_text",
    "high_noise_warning",
    "mismatch_step",
    "noise_sentence",
    "noise_word",
    "plate_argument",
    "plate_sentence",
    "reliance_sentences",
    "rests_on",
    "scale_sentences",
    "stated_noise",
]

CONTAINED: Final = "The intervals contain"
"""How the sentence begins that says which errors of size, mass and scale the intervals contain."""
HIGH_NOISE: Final = "The noise inferred from the misfit is"
"""How the warning of a high inferred noise begins."""
DETERMINED: Final[dict[Verdict, Determined]] = {
    "determined by the data": "yes",
    "determined by data and prior": "partly",
    "determined by the prior": "no",
    MISFIT: "partly",
}
"""Whether the frequencies determine a constant, in a word."""

UNDESCRIBED: Final = "a plate model that does not describe the frequencies"
"""What decides a constant where the misfit is no noise."""

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

# Relative noise of a tap test: usual up to the first level, high from there on.
_GOOD, _USUAL = 0.003, 0.01
# Least visible fraction of an error of size that the frequencies are said to show.
_VISIBLE = 0.3
# Least relative error of a constant, for 1 % of a size, that is worth a word, %.
_WORTH_TELLING = 0.3
# Probability of errors of size, mass and scale among all causes that is worth a word.
_SMALL_WEIGHT = 0.01
_SCALE_WORDS: Final = {
    "thickness": "thickness",
    "length": "length",
    "width": "width",
    "density": "density",
    "mass": "mass",
    FREQUENCY_SCALE: "the analyser's frequency scale",
}


def constant_title(name: str, material: Material | Hybrid) -> str:
    """A constant in words, of a hybrid with its material; a name that has none stands for itself."""
    of, plain = split_name(name)
    part = material.parts.get(of)
    title = "" if part is None else _TITLES_OF[part.symmetry].get(plain, "")
    return f"{title}{f', {part.name or of}' if of and part is not None else ''}" if title else name


def frequencies_text(n: int) -> str:
    """A number of measured frequencies."""
    return "1 measured frequency" if n == 1 else f"{n} measured frequencies"


def decider(verdict: Verdict, name: str, prior: Prior) -> str:
    """What decides a constant, alone or with the frequencies, in the unit of the plate file."""
    if verdict == MISFIT:
        return UNDESCRIBED
    return "the frequencies" if DETERMINED[verdict] == "yes" else f"its {' '.join(_prior_text(name, prior))}"


def reliance_sentences(
    reliances: Sequence[Reliance], prior_of: Callable[[str], Prior], shown: Sequence[str]
) -> tuple[str, ...]:
    """What the prior of one constant does to the interval of another.

    prior_of : a constant. shown : constants that are worth a word.
    """
    said = []
    for r in reliances:
        if r.name not in shown:
            continue
        kind, value = _prior_text(r.on, prior_of(r.on))
        said.append(
            f"The interval of {r.name} rests on the {kind} of {r.on} too, {value}: were the {kind} twice as "
            f"wide, the interval of {r.name} would be {significant(100.0 * r.widening, 2)} % wider."
        )
    return tuple(said)


def rests_on(name: str, reliances: Sequence[Reliance], prior_of: Callable[[str], Prior]) -> str:
    """The priors of others that the interval of a constant rests on, in a few words; "" for none."""
    others = [f"the {_prior_text(r.on, prior_of(r.on))[0]} of {r.on}" for r in reliances if r.name == name]
    return listed(others, "and") if others else ""


def _prior_text(name: str, prior: Prior) -> tuple[str, str]:
    """What a prior is called, and its numbers in the unit of the plate file."""
    unit = f" {unit_of(name)}".rstrip()
    if isinstance(prior, TruncatedNormal):
        return "prior", f"{to_user(name, prior.loc):.5g} +- {to_user(name, prior.scale):.3g}{unit}"
    return "bounds", f"{to_user(name, prior.lower):.5g} to {to_user(name, prior.upper):.5g}{unit}"


def plate_argument(specimen: Specimen) -> str:
    """What a command takes for a plate, quoted for a shell."""
    return shlex.quote(specimen.source.removeprefix("built-in "))


def plate_sentence(specimen: Specimen) -> str:
    """The plate as the model has it: what is not named here is not in the model."""
    plate = specimen.plate
    mass = plate.mass if plate.mass is not None else plate.density * plate.area * plate.thickness
    weight = f", {mass * 1e3:.4g} g" if plate.mesh is None or plate.mass is not None else ""
    layup = "" if specimen.material.isotropic else f", layup {layup_text(specimen)}"
    air = f"air of {specimen.air_density:g} kg/m3" if specimen.air_density else "no air"
    if specimen.sensors:
        masses = [f"{s.mass * 1e3:g} g at ({s.x * 1e3:g}, {s.y * 1e3:g}) mm" for s in specimen.sensors]
        attached = f"with {listed(masses, 'and')} attached"
    else:
        attached = "nothing attached to the plate"
    return (
        f"The plate in the model: {size_text(plate)} mm{weight}{layup}, {edges_text(plate.edges)}, "
        f"{attached}, {air}."
    )


def attached_step(specimen: Specimen) -> tuple[str, ...]:
    """What to ask about masses on the plate, where the file gives none."""
    if specimen.sensors:
        return ()
    plate = specimen.plate
    percent = 0.1 / (plate.mass or plate.density * plate.area * plate.thickness)
    return (
        "Was an accelerometer, a cable or tape on the plate? State its mass under [[sensor]]: 1 g is "
        f"{significant(percent, 2)} % of this plate's mass, and a mass that is left out makes the moduli too "
        "low, near a free corner by several times its share.",
    )


def diagnose_step(specimen: Specimen) -> tuple[str, ...]:
    """To ask what the model gets wrong, where `diagnose` takes the plate."""
    if specimen.plate.layup.kinds:
        return ()
    return (f"Ask what the plate model gets wrong: cpam-bayes diagnose {plate_argument(specimen)}",)


def mismatch_step(
    specimen: Specimen, slips: Sequence[str], found: Sequence[str | None] = ()
) -> tuple[str, ...]:
    """What to check before all else where the frequency list contradicts the plate.

    slips : of the answer. found : label of the mode that each frequency was paired with, None for no mode.
    """
    labels = () if specimen.measurement is None else specimen.measurement.labels
    other = [
        given
        for given, label in zip(labels, found, strict=False)
        if given and (label is None or same_label(given) != same_label(label))
    ]
    if not (contradicts_list(slips) or other):
        return ()
    edges = f"the edges ({edges_text(specimen.plate.edges)})"
    layup = () if specimen.material.isotropic else ("the layup",)
    named = ("the labels",) if any(labels) else ()
    what = listed([*named, edges, *layup, "the order and completeness of the list"], "and")
    return (f"Check {what}: these frequencies contradict the plate model.",)


def noise_word(level: float) -> str:
    """How a relative noise compares with that of a tap test."""
    if level <= _GOOD:
        return "which is low for a tap test"
    return "which is usual for a tap test" if level <= _USUAL else "which is high for a tap test"


def high_noise_warning(level: float) -> tuple[str, ...]:
    """What an inferred noise above that of a usual tap test may mean; level : relative."""
    if level <= _USUAL:
        return ()
    return (
        f"{HIGH_NOISE} {significant(100.0 * level, 2)} % of a frequency, more than "
        "the scatter of a usual tap test: the plate model may lack something, and then the intervals can "
        "miss the true constants.",
    )


def noise_sentence(level: float, source: str) -> str:
    """What noise the intervals stand on; level : relative, source : where the level comes from."""
    percent = significant(100.0 * level, 2)
    return f"The intervals assume a noise of {percent} % of a frequency, {noise_word(level)}; {source}."


def stated_noise(measurement: Measurement) -> str:
    """Where the noise of a measurement is stated."""
    if measurement.frequency_sd is None:
        return "relative_std of the plate file"
    return f"{measurement.sd_source}{'' if measurement.origin else ' of the plate file'}"


def contained_sentence(
    plate: Plate, *, counted: bool = True, found: Collection[str] = (), weight: float = 0.0
) -> str:
    """Which of sizes, mass and frequency scale have their errors in the intervals, and which do not.

    counted : whether the intervals count with [plate.sd]. found : those whose error the model of the answer
    contains. weight : probability of all those among the causes that the answer is averaged over.
    """
    weighed = "density" if plate.mass is None else "mass"
    names = ("thickness", "length", "width", weighed, FREQUENCY_SCALE)
    stated = plate.sd if counted else {}
    inside = [f"{_SCALE_WORDS[n]} (+- {to_user(n, stated[n]):g} {_unit(n)})" for n in names if n in stated]
    inside += [f"{_SCALE_WORDS[n]} (what was found)" for n in names if n in found and n not in stated]
    outside = [_SCALE_WORDS[n] for n in names if n not in stated and n not in found]
    said = f"{CONTAINED} "
    if inside:
        said += f"the uncertainty of {listed(inside, 'and')}; they contain "
    said += f"no error of {listed(outside, 'or')}, which count as exact"
    if weight >= _SMALL_WEIGHT:
        said += f"; as causes that were weighed they have a probability of {significant(weight, 2)} together"
    return f"{said}."


def scale_sentences(
    specimen: Specimen, errors: Sequence[ScaleError], shown: Sequence[str], *, counted: bool = True
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """What errors of size, mass and frequency scale do outside the intervals, and what to do about them.

    shown : constants that are worth a word. counted : whether the intervals count with [plate.sd].
    """
    said, todo, missing, parts = [], [], [], []
    for e in errors:
        if e.sd is not None or e.visible > _VISIBLE:
            continue
        moved = [
            f"{name} by {fixed(abs(e.shift[name]), 1)} %"
            for name in shown
            if abs(e.shift[name]) >= _WORTH_TELLING
        ]
        if not moved:
            continue
        parts.append(f"1 % of {_SCALE_WORDS[e.name]} moves {listed(moved, 'and')}")
        if e.name != FREQUENCY_SCALE:
            missing.append("mass" if e.name == "density" and _densities_of_plies(specimen) else e.name)
    if parts:
        said.append(
            "Errors outside the intervals hardly show in the frequencies, and the constants take them up: "
            f"{'; '.join(parts)}."
        )
    if missing:
        keys = listed([user_name(name) for name in missing], "and")
        verb = _HOW[missing[0]] if len(missing) == 1 else "Gauge and weigh the plate"
        if counted:
            verb += f", and give [plate.sd] with {keys}: the intervals then contain those errors"
        todo.append(f"{verb}.")
    return tuple(said), tuple(todo)


def _densities_of_plies(specimen: Specimen) -> bool:
    """Whether the density of the plate follows from those of its materials."""
    return any(kind.density is not None for kind in specimen.plate.layup.kinds)


_HOW: Final = {
    "thickness": "Gauge the thickness at ten points",
    "density": "Weigh the plate",
    "mass": "Weigh the plate",
    "length": "Measure the length along both edges",
    "width": "Measure the width along both edges",
}


def _unit(name: str) -> str:
    return {"density": "kg/m3"}.get(name, unit_of(name))
