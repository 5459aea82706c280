"""Slips in a plate file that ruin the answer, with the likely cure, each a sentence above the answer.

What may be meant, but rarely is. Lists that no plate of the file can have are refused (`reachable`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from cpam_bayes.formatting import listed, significant
from cpam_bayes.forward_model.model import reference_constants
from cpam_bayes.plate import Measurement, Specimen, to_user, unit_of, user_name

__all__ = [
    "HIGH_MISFIT",
    "birge_ratio",
    "common_factor_slips",
    "contradicts_list",
    "count_slips",
    "equal_list_slips",
    "misfit_over_noise",
    "misfit_slips",
    "noise_slips",
    "reference_slips",
    "stated_noise_slips",
]

Array = NDArray[np.float64]

HIGH_MISFIT: Final = 0.03
"""Relative misfit above which a list does not belong to its plate model: no tap test scatters so."""

# Lists of several plates that differ by no more than this everywhere are most likely one measurement.
_EQUAL = 2e-3
# Probability of a misfit, by noise as stated, below which it is no accident.
_UNEXPLAINED = 1e-3
# Standard deviations of [material.sd] from which a modulus is no batch of its material any more.
_FAR_SD = 3.0
# Moduli whose ratios to their references differ by no more than this factor have one ratio in common.
_COMMON = 1.3
# How every slip begins that says of a list and its plate model that they do not belong together.
_NOT_DESCRIBED: Final = "the plate model does not describe these frequencies"


def reference_slips(specimen: Specimen) -> tuple[str, ...]:
    """Reference constants outside their own bounds."""
    outside = []
    reference = reference_constants(specimen)
    for name in specimen.unknowns.names:
        prior = specimen.unknowns[name].prior
        if name in specimen.material.constants and not prior.lower <= reference[name] <= prior.upper:
            value, low, high = (to_user(name, v) for v in (reference[name], prior.lower, prior.upper))
            span = f"{low:.5g} to {high:.5g} {unit_of(name)}".rstrip()
            outside.append(f"{user_name(name)} = {value:.5g} lies outside its bounds {span}")
    if not outside:
        return ()
    return (
        f"the reference value of [material] contradicts [unknowns]: {listed(outside, 'and')}; correct the "
        "value or widen the bounds",
    )


def count_slips(n_frequencies: int, n_unknowns: int) -> tuple[str, ...]:
    """Fewer frequencies than unknowns."""
    if n_frequencies >= n_unknowns:
        return ()
    many = "1 frequency" if n_frequencies == 1 else f"{n_frequencies} frequencies"
    return (
        f"{many} for {n_unknowns} unknowns: fewer frequencies than unknowns, so that the bounds decide the "
        f"answer; measure at least {n_unknowns + 2} frequencies, or take constants that are known out of "
        "[unknowns]",
    )


def misfit_slips(level: float) -> tuple[str, ...]:
    """A misfit that no tap test makes; level : inferred noise, or rms residual where the noise is stated."""
    if not level > HIGH_MISFIT:
        return ()
    return (
        f"{_NOT_DESCRIBED}: with its best constants the misfit is "
        f"{significant(100.0 * level, 2)} % of a frequency, where a tap test repeats to 1 % or better; do "
        "not use the constants before the units, the sizes, the edges, the layup and the order and "
        "completeness of the list are checked",
    )


def misfit_over_noise(measurement: Measurement, residuals: Array, n_fitted: int) -> float:
    """The misfit in times of the stated noise by `birge_ratio`; 1 where no noise is stated.

    residuals : (n,) predicted / measured - 1, nan where a frequency belongs to no mode. n_fitted : constants.
    """
    f, paired = measurement.frequencies, np.isfinite(residuals)
    if measurement.relative_std is None and measurement.frequency_sd is None:
        return 1.0
    noise = measurement.noise_sd(measurement.relative_std or 0.0)
    sd = np.sqrt(noise**2 + measurement.resolution**2 / 12.0) / f
    return birge_ratio(residuals[paired] / sd[paired], n_fitted)


def birge_ratio(standardised: Array, n_fitted: int) -> float:
    """A misfit in times of the noise, 1 where the noise explains it or no frequency is left over to tell.

    The root of chi-squared over its degrees of freedom (Birge, Phys. Rev. 40, 1932), where that is exceeded
    with a probability below 0.001.

    standardised : (n,) residuals over the standard deviations of the noise. n_fitted : constants.
    """
    freedom = len(standardised) - n_fitted
    if freedom < 1:
        return 1.0
    chi_squared = float(np.sum(standardised**2))
    explained = chi2.sf(chi_squared, freedom) >= _UNEXPLAINED
    return 1.0 if explained else float(np.sqrt(chi_squared / freedom))


def noise_slips(measurement: Measurement, residuals: Array, n_fitted: int) -> tuple[str, ...]:
    """A misfit that noise as stated does not explain; arguments as of `misfit_over_noise`."""
    times = misfit_over_noise(measurement, residuals, n_fitted)
    if times == 1.0:
        return ()
    return (
        f"{_NOT_DESCRIBED}: with its best constants the misfit is "
        f"{significant(times, 2)} times the stated noise, so that the true "
        "constants can lie far outside their intervals; ask `diagnose` what the model gets wrong, and look "
        "for a mass that was left on the plate, a misread frequency, a missed mode, the edges and the layup",
    )


def contradicts_list(slips: Sequence[str]) -> bool:
    """Whether one of the slips says that the plate model does not describe the frequencies."""
    return any(slip.startswith(_NOT_DESCRIBED) for slip in slips)


def stated_noise_slips(measurement: Measurement) -> tuple[str, ...]:
    """A stated noise that no tap test has: per cent written as a fraction, most likely."""
    if measurement.frequency_sd is not None:
        relative = measurement.frequency_sd / measurement.frequencies
        at, level = int(np.argmax(relative)), float(np.mean(relative))
        key = (
            f"{measurement.sd_source} (most at {measurement.frequencies[at]:g} Hz, "
            f"{significant(100.0 * relative[at], 2)} %)"
        )
    elif measurement.relative_std is not None:
        level, key = measurement.relative_std, f"relative_std = {measurement.relative_std:g}"
    else:
        return ()
    if level <= HIGH_MISFIT:
        return ()
    percent = significant(100.0 * level, 2)
    meant = ""
    if measurement.frequency_sd is None:
        meant = f"if {level:g} % is meant, write relative_std = {level / 100.0:g}; "
    return (
        f"the stated noise, {key}, is {percent} % of a frequency, where a tap test repeats to 1 % or better: "
        f"{meant}with so much noise the frequencies tell little, and any misfit passes for noise",
    )


def common_factor_slips(specimen: Specimen, estimates: Mapping[str, tuple[float, float]]) -> tuple[str, ...]:
    """All moduli far on one side of their references: a wrong size, mass or frequency scale, most likely.

    Of a thin plate f^2 is proportional to E h^2 / rho, or E h^3 / m: an error of h, rho or m is a common
    factor of all moduli, which no frequency shows.

    estimates : modulus that the frequencies determine -> its estimate and standard deviation, Pa
    """
    reference, ratios, distances = reference_constants(specimen), {}, {}
    for name, (value, sd) in estimates.items():
        known = specimen.material.sd.get(name)
        if known is None or unit_of(name) != "GPa":
            continue
        ratios[name] = value / reference[name]
        distances[name] = (value - reference[name]) / float(np.hypot(known, sd))
    above = bool(distances) and min(distances.values()) > _FAR_SD
    below = bool(distances) and max(distances.values()) < -_FAR_SD
    if not (above or below):
        return ()
    far = [f"{name} by {significant(abs(z), 2)}" for name, z in distances.items()]
    who = "the one modulus" if len(far) == 1 else "every modulus"
    begun = (
        f"{who} that these frequencies determine lies far {'above' if above else 'below'} its reference, "
        f"{listed(far, 'and')} standard deviations of [material.sd]"
    )
    cure = _cure_of_factor(specimen, ratios)
    return (
        f"{begun}: {cure}; check these numbers, and whether [material] is this plate's material, before the "
        "constants are used",
    )


def _cure_of_factor(specimen: Specimen, ratios: Mapping[str, float]) -> str:
    """What a wrong number would have to be to make the moduli so many times their references."""
    weighed = specimen.plate.mass is not None
    mass = "mass_g" if weighed else "density_kg_m3"
    if max(ratios.values()) > _COMMON * min(ratios.values()):
        return f"look for a wrong thickness_mm or {mass}, or an analyser with a wrong frequency scale"
    ratio = float(np.exp(np.mean(np.log(list(ratios.values())))))
    thickness = specimen.plate.thickness * 1e3
    true_thickness = thickness * ratio ** (1.0 / (3.0 if weighed else 2.0))
    attached = "a mass left on the plate, " if ratio < 1.0 else ""
    return (
        f"a factor of {significant(ratio, 3)} on the moduli is what a wrong thickness, mass or frequency "
        f"scale makes: a true thickness of {significant(true_thickness, 3)} mm for thickness_mm = "
        f"{thickness:g}, a true {mass} of {significant(1.0 / ratio, 3)} times the stated one, {attached}or "
        f"frequencies that are {significant(float(np.sqrt(ratio)), 3)} times the true ones"
    )


def equal_list_slips(specimens: Sequence[Specimen]) -> tuple[str, ...]:
    """Plates whose lists are so nearly equal that they are most likely one measurement."""
    slips = []
    for i, first in enumerate(specimens):
        for second in specimens[i + 1 :]:
            a, b = first.measurement, second.measurement
            if a is None or b is None or a.size != b.size:
                continue
            apart = float(np.max(np.abs(b.frequencies / a.frequencies - 1.0)))
            if apart > _EQUAL:
                continue
            how = "are equal" if apart == 0.0 else f"differ by {significant(100 * apart, 2)} % at most"
            slips.append(
                f"the frequencies of {first.name} and {second.name} {how}: one plate measured twice is not "
                "two plates, and counting the list twice makes the answer too sure; give one plate file with "
                "the mean of both lists and their scatter as frequency_sd_hz"
            )
    return tuple(slips)
