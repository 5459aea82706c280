"""Checks of a plate file for what cannot be computed or believed: errors or warnings, with advice."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from typing import Final

import numpy as np
from scipy.stats import chi2

from cpam_bayes.answer import Constant, Notice, Severity
from cpam_bayes.errors import LowFrequencyError, PlateFileError
from cpam_bayes.formatting import listed, significant
from cpam_bayes.forward_model.model import NO_PARAMETERS, plate_problem, reference_constants
from cpam_bayes.mechanics.dense import discretise
from cpam_bayes.mechanics.modes import RigidBodyError, solve
from cpam_bayes.mechanics.problem import Array
from cpam_bayes.mechanics.ritz import RitzSettings, ritz_space
from cpam_bayes.parameters import ParameterSet
from cpam_bayes.plate import Material, Measurement, Plate, Specimen, joined_name, unit_of
from cpam_bayes.plate.edges import conditions
from cpam_bayes.running import single_blas_thread

LARGE_ERROR: Final = 1e-3
"""Relative error of the solver from which it is no longer small, where the noise is not known."""

MAX_MODES = 100
"""Largest number of modes of a plate that are computed."""

SUSPICIOUS_RATIO = 3.0
"""Prediction over measurement beyond which a unit in the plate file is suspected."""

# Longer side over thickness from which a failure is blamed on the thickness.
_THIN = 300.0

# Prediction over measurement -> the slips that cause it. A frequency goes as h / sqrt(density) or, of a
# plate that was weighed, as h sqrt(h / mass).
_CURES: Final = (
    (1000.0, "frequencies in kHz for Hz, or sizes in m for mm"),
    (31.6, "a mass in kg for g, a density in g/cm3 for kg/m3, or constants in MPa for GPa"),
    (25.4, "sizes in inches for mm"),
    (10.0, "sizes in cm for mm, or a thickness 10 times too large"),
    (1.0 / (2.0 * math.pi), "frequencies in rad/s for Hz"),
    (1.0 / 10.0, "a thickness 10 times too small, as of cm for mm, or decimal commas that were lost"),
    (1.0 / 100.0, "decimal commas that were lost, 8020 for 80,20"),
    (1.0 / 31.6, "constants in TPa for GPa"),
    (1.0 / 1000.0, "frequencies in mHz for Hz, or sizes in um for mm"),
)
_CURES_WHEN_WEIGHED: Final = (
    (1000.0, "frequencies in kHz for Hz"),
    (31.6, "a thickness 10 times too large, a mass in kg for g, or constants in MPa for GPa"),
    (25.4, "sizes in inches for mm"),
    (1.0 / (2.0 * math.pi), "frequencies in rad/s for Hz"),
    (1.0 / 10.0, "decimal commas that were lost, 802 for 80,2"),
    (1.0 / 100.0, "decimal commas that were lost, 8020 for 80,20"),
    (
        1.0 / 31.6,
        "a thickness 10 times too small, as of cm for mm, a mass 1000 times too large, or constants in TPa "
        "for GPa",
    ),
    (1.0 / 1000.0, "frequencies in mHz for Hz"),
)
# Factor by which a ratio may differ from these.
_NEAR = 1.35


def rectangular_only(command: str) -> str:
    """Advice for a plate with a mesh that a command does not compute."""
    return f"{command} computes rectangular plates only; leave mesh out"


def require_supported(
    specimen: Specimen, no_mesh: str | None, no_air: str | None = None, *, angles: bool = False
) -> Specimen:
    """Return the specimen, or raise `PlateFileError` with all that cannot be computed yet.

    no_mesh : message for a plate with a mesh, None where meshes are computed.
    no_air : message for air in the plate file, None where it is part of the model.
    angles : whether some may be unknown, if the list has no labels.
    """
    problems = _not_computed(specimen, no_mesh, no_air)
    problems += _angles_asked(specimen) if angles else _unknown_angles(specimen)
    _raise(specimen, problems)
    return specimen


def require_diagnosable(specimen: Specimen) -> Specimen:
    """Return the specimen, or raise `PlateFileError` if it cannot be diagnosed."""
    problems = [*_not_computed(specimen, rectangular_only("diagnose")), *_unknown_angles(specimen)]
    if specimen.measurement is None:
        problems.append("[measurement] is missing, nothing to be compared with the model")
    if not specimen.unknowns.size:
        problems.append("[unknowns] is missing; name the constants that may differ from [material]")
    _raise(specimen, problems)
    return specimen


def require_sequence(specimen: Specimen) -> Specimen:
    """Return the specimen, or raise `PlateFileError` if its stacking sequence cannot be sought."""
    problems = _not_computed(specimen, rectangular_only("sequence"))
    if not specimen.plate.layup.n_unknown:
        problems.append(
            f'plate.layup: received {specimen.plate.layup.text}, none of its angles is "?"; write "?" for '
            "the unknown ones"
        )
    if specimen.measurement is None:
        problems.append("[measurement] is missing, nothing to tell the sequences apart by")
    problems += _angles_asked(specimen)
    if not specimen.unknowns.size:
        problems.append("[unknowns] is missing, the constants must be free within bounds")
    _raise(specimen, problems)
    return specimen


def _not_computed(specimen: Specimen, no_mesh: str | None, no_air: str | None = None) -> list[str]:
    problems = []
    mesh, air = specimen.plate.mesh, specimen.air_density
    if mesh is not None and no_mesh is not None:
        problems.append(f"plate.mesh: received {mesh}, {no_mesh}")
    if air and mesh is not None and no_mesh is None:
        no_air = "the air about a plate with a mesh is not computed; leave air_density_kg_m3 out"
    if air and no_air is not None:
        problems.append(f"environment.air_density_kg_m3: received {air:g}, {no_air}")
    return problems


def _angles_asked(specimen: Specimen) -> list[str]:
    """Reasons why unknown angles cannot be identified, if there are some."""
    layup, measurement = specimen.plate.layup, specimen.measurement
    problems: list[str] = []
    if layup.n_unknown and specimen.material.isotropic:
        problems.append(
            f"plate.layup: received {layup.text}, the material is isotropic, which has no ply angles; leave "
            "layup out"
        )
    if layup.n_unknown and measurement is not None and measurement.names_modes:
        problems.append(
            f"measurement.{'shapes' if measurement.shapes else 'labels'}: received beside unknown angles, "
            "which pair frequencies with modes in ascending order; leave them out"
        )
    return problems


def _unknown_angles(specimen: Specimen) -> list[str]:
    layup = specimen.plate.layup
    if not layup.n_unknown:
        return []
    return [
        f"plate.layup: received {layup.text}, unknown angles: {layup.n_unknown}; a known layup is needed, "
        'write the angles for "?", or let `sequence` or `identify --backend pso` find them'
    ]


def require_paired_list(specimen: Specimen) -> Specimen:
    """Return the specimen, or raise `PlateFileError` if its list may lack modes."""
    measurement = specimen.measurement
    if measurement is not None and not measurement.complete:
        if measurement.mode_probability is not None:
            received = ": candidate peaks, which may be no modes"
        elif measurement.whole is not None and measurement.whole.complete:
            received = ".left_out: the list then lacks modes in between"
        else:
            received = ".complete: received false"
        _raise(
            specimen,
            [
                f"measurement{received}, this version pairs the first model mode "
                "with the first frequency and so on; use --backend emcee, which sums over all pairings"
            ],
        )
    return specimen


def exchange_notices(specimen: Specimen) -> tuple[Notice, ...]:
    """A notice where the frequencies cannot tell the two axes of orthotropic plies apart.

    Their angles are unknown, or the plate is square with four equal edges.
    """
    plate, unknowns, measurement = specimen.plate, specimen.unknowns, specimen.measurement
    square = plate.length == plate.width and len(set(plate.edges)) == 1
    turnable = square or bool(np.all(plate.layup.unknown_index >= 0))
    labelled = measurement is not None and measurement.names_modes
    if (
        labelled
        or specimen.sensors
        or not turnable
        or not all(_exchangeable(name, part, unknowns) for name, part in specimen.material.parts.items())
    ):
        return ()
    return (Notice("axes_exchange", facts={"square": square}),)


def _exchangeable(name: str, material: Material, unknowns: ParameterSet) -> bool:
    """Whether the two axes of a material can be exchanged within the bounds."""
    e1, e2, nu12 = (joined_name(name, constant) for constant in ("E1", "E2", "nu12"))
    if material.symmetry != "orthotropic" or not {e1, e2, nu12} <= set(unknowns.names):
        return False
    first, second = unknowns[e1].prior, unknowns[e2].prior
    return max(first.lower, second.lower) < min(first.upper, second.upper)


def require_choice(name: str, value: object, accepted: Sequence[str]) -> None:
    """Raise ``ValueError`` where an argument is none of the accepted words."""
    if value not in accepted:
        raise ValueError(f"{name}: received {value!r}, accepted: {' '.join(accepted)}")


def require_whole(name: str, value: object, low: int, high: int) -> None:
    """Raise ``ValueError`` where an argument is not a whole number from ``low`` to ``high``."""
    if isinstance(value, bool) or not isinstance(value, int | np.integer) or not low <= value <= high:
        raise ValueError(f"{name}: received {value!r}, accepted: a whole number from {low} to {high}")


def require_seed(seed: object) -> None:
    """Raise ``ValueError`` where a seed cannot repeat an answer."""
    require_whole("seed", seed, 0, 2**63 - 1)


def require_modes(n_modes: object) -> None:
    """Raise ``ValueError`` where a number of modes is given that cannot be computed."""
    if n_modes is not None:
        require_whole("n_modes", n_modes, 1, MAX_MODES)


def require_number(name: str, value: object, most: float) -> None:
    """Raise ``ValueError`` where an argument is not a number above 0 and at most ``most``."""
    real = isinstance(value, int | float | np.number) and not isinstance(value, bool)
    if not (real and 0.0 < float(value) <= most):  # type: ignore[arg-type]
        raise ValueError(f"{name}: received {value!r}, accepted: a number above 0 and at most {most:g}")


@contextmanager
def explained_failures(specimen: Specimen) -> Iterator[None]:
    """Raise a `PlateFileError` with advice in place of the solver's ``RigidBodyError``."""
    try:
        yield
    except RigidBodyError as error:
        raise _solver_failure(specimen, error) from error


def likely_cure(ratio: float, *, weighed: bool) -> str:
    """Advice on the slip of units that makes predicted frequencies ``ratio`` times the measured ones.

    weighed : whether the plate file has a mass, and the density follows from it
    """
    cures = _CURES_WHEN_WEIGHED if weighed else _CURES
    likely = [text for value, text in cures if 1.0 / _NEAR < ratio / value < _NEAR]
    if not likely:  # constants may be far from their reference too
        nearest = min(cures, key=lambda cure: abs(math.log(ratio / cure[0])))
        likely = [nearest[1]] if abs(math.log(ratio / nearest[0])) < math.log(2.5) else []
    if not likely:
        return "check the units of sizes, mass or density, constants and frequencies, and the edges"
    return f"the likely slip is {likely[0]}; check the units of the plate file"


def units_notices(ratio: Array, plate: Plate, severity: Severity = "warning") -> tuple[Notice, ...]:
    """A notice where a predicted frequency is not even of the order of the measured one.

    None for a plate whose stated numbers disagree, which is reason enough.

    ratio : predicted over measured frequencies
    """
    worst = float(ratio[np.argmax(np.abs(np.log(ratio)))])
    if 1 / SUSPICIOUS_RATIO <= worst <= SUSPICIOUS_RATIO or disagrees(plate):
        return ()
    facts = {"ratio": worst, "median": float(np.median(ratio)), "weighed": plate.mass is not None}
    return (Notice("units", severity, facts),)


def _solver_failure(specimen: Specimen, error: RigidBodyError) -> ValueError:
    plate = specimen.plate
    ratio = max(plate.length, plate.width) / plate.thickness
    if ratio < _THIN:
        return PlateFileError(
            f"{specimen.source}: the plate solver cannot tell bending from rounding; check [plate] and "
            f"[material] for slips of units ({error})"
        )
    return PlateFileError(
        f"{specimen.source}: plate.thickness_mm: received {plate.thickness * 1e3:g}, 1/{ratio:.0f} "
        f"of the longer side, too thin for the plate solver; check its unit"
    )


def _raise(specimen: Specimen, problems: list[str]) -> None:
    if problems:
        raise PlateFileError(*(f"{specimen.source}: {problem}" for problem in problems))


# A list this many times outside the reach of the bounds is refused; one that may lack its first modes, or
# whose labels identify its modes, only where it is further away.
_UNREACHABLE, _UNREACHABLE_WITH_GAPS = 3.0, 30.0
# A first frequency this many times below the lowest within the bounds is not of the plate; with unknown
# angles, which have bounds of their own, only the lowest of one layup is known.
_BELOW_ALL, _BELOW_ALL_OF_UNKNOWN_ANGLES = 3.0, 10.0
# Frequencies to a few per cent, which is ample here.
_SETTINGS: Final = RitzSettings(9, 9)


@single_blas_thread
def require_reachable(specimen: Specimen) -> Specimen:
    """Return the specimen, or raise `PlateFileError` if no constants come near its (first) frequencies.

    The median over the list of the logarithm of measured over predicted frequencies is checked, with all
    unknown moduli at their lower bounds and at their upper ones. Not for a mesh, nor where bending cannot be
    told from rounding, which is reported elsewhere. A plate whose thickness, mass and density disagree is
    refused for that.
    """
    measurement = specimen.measurement
    if measurement is None or specimen.plate.mesh is not None:
        return specimen
    n = measurement.size
    try:
        reference = _frequencies(specimen, reference_constants(specimen), n)
        low, high = (_frequencies(specimen, _at_bounds(specimen, end), n) for end in ("lower", "upper"))
    except (RigidBodyError, np.linalg.LinAlgError):
        return specimen
    above = float(np.exp(np.median(np.log(low / measurement.frequencies))))
    below = float(np.exp(np.median(np.log(measurement.frequencies / high))))
    with_gaps = not measurement.complete or measurement.names_modes
    limit = _UNREACHABLE_WITH_GAPS if with_gaps else _UNREACHABLE
    if max(above, below) <= limit:
        _require_no_motion_of_the_support(specimen, float(low[0]))
        return specimen
    ratio = float(np.exp(np.median(np.log(reference / measurement.frequencies))))
    span = [significant(float(v), 3) for v in (reference[0], reference[-1])]
    given = [f"{float(v):.6g}" for v in (measurement.frequencies[0], measurement.frequencies[-1])]
    if disagrees(specimen.plate):
        raise _disagreement(specimen)
    raise PlateFileError(
        f"{specimen.source}: measurement.frequencies_hz: received {' to '.join(dict.fromkeys(given))} Hz, "
        f"where the plate with the constants of [material] has {' to '.join(dict.fromkeys(span))} Hz, "
        f"{significant(ratio, 3)} times as much, and no constants within [unknowns] come near: "
        f"{likely_cure(ratio, weighed=specimen.plate.mass is not None)}"
    )


def _require_no_motion_of_the_support(specimen: Specimen, lowest: float) -> None:
    """Raise `LowFrequencyError` for frequencies far below ``lowest``, Hz, that at the lower bounds."""
    assert specimen.measurement is not None
    f = specimen.measurement.frequencies
    unknown = bool(specimen.plate.layup.n_unknown)
    too_low = f[f < lowest / (_BELOW_ALL_OF_UNKNOWN_ANGLES if unknown else _BELOW_ALL)]
    if not too_low.size:
        return
    if disagrees(specimen.plate):
        raise _disagreement(specimen)
    n = too_low.size
    many, are, them = (
        (f"the first {n} frequencies", "are", "them") if n > 1 else ("the first frequency", "is", "it")
    )
    received = listed([f"{value:.6g}" for value in too_low], "and")
    motion = (
        "motion of the plate as a rigid body on its support"
        if any(edge.is_free for edge in conditions(specimen.plate.edges))
        else "hum"
    )
    raise LowFrequencyError(
        f"{specimen.source}: measurement.frequencies_hz: received {received} Hz, "
        f"where no constants within [unknowns] give this plate a frequency below "
        f"{significant(lowest, 3)} Hz: {many} of the list {are} most likely "
        f"{motion}, which is no mode of the plate; leave {them} out, or set the decimal point right"
    )


def _disagreement(specimen: Specimen) -> PlateFileError:
    """The error for frequencies out of reach where the plate's thickness, mass and density disagree."""
    plate = specimen.plate
    assert plate.thicknesses is not None
    gauged, by_mass, taken = (
        significant(1e3 * value, 3) for value in (*(mean for mean, _ in plate.thicknesses), plate.thickness)
    )
    return PlateFileError(
        f"{specimen.source}: plate.thickness_mm: received {gauged} mm, where mass over density is {by_mass} "
        f"mm, {plate.thicknesses_apart:.0f} standard deviations apart, accepted: a thickness, mass_g and "
        f"density_kg_m3 that agree; no constants within [unknowns] come near the frequencies with {taken} "
        "mm, which is taken of both: gauge and weigh the plate again, and check the density"
    )


def _at_bounds(specimen: Specimen, end: str) -> dict[str, float]:
    """Reference constants with the unknown moduli at one end of their bounds."""
    constants = reference_constants(specimen)
    for name in specimen.unknowns.names:
        if unit_of(name):
            constants[name] = float(getattr(specimen.unknowns[name].prior, end))
    return constants


def _frequencies(specimen: Specimen, constants: dict[str, float], n: int) -> Array:
    """The lowest frequencies of the plate with given constants, roughly, (n,) Hz."""
    material = specimen.material.with_constants(constants)
    layup = specimen.plate.layup
    if layup.n_unknown:
        evenly = np.linspace(-90.0, 90.0, layup.n_unknown + 1)[1:]
        layup = layup.with_angles(evenly)
    plain = replace(specimen, material=material, plate=replace(specimen.plate, layup=layup))
    problem = plate_problem(plain, NO_PARAMETERS)
    operator = discretise(problem, ritz_space(problem.edges, problem.nominal, _SETTINGS), {})
    return np.asarray(solve(operator, *operator.coefficients({}), n).frequencies[0])


USUAL_NOISE: Final = 0.01
"""Relative noise of a tap test: usual up to here, high above."""
HIGH_MISFIT: Final = 0.03
"""Relative misfit above which a list does not belong to its plate model: no tap test scatters so much."""

# Lists of several plates that differ nowhere by more than this are most likely one measurement.
_EQUAL = 2e-3
# p-value of a misfit, with the stated noise, below which noise does not explain it.
_UNEXPLAINED = 1e-3
# Standard deviations of [material.sd] beyond which a modulus is not that of a batch of its material.
_FAR_SD = 3.0
# Moduli whose ratios to their references differ by no more than this factor share one ratio.
_COMMON = 1.3
# Standard deviations of a constant from its prior beyond which it contradicts it.
_CONTRADICTED_SD = 5.0
# Codes of the notices which say that the plate model does not describe the frequencies.
_CONTRADICTING: Final = frozenset({"large_misfit", "misfit_over_noise", "no_sequence_explains"})


def reference_slips(specimen: Specimen) -> tuple[Notice, ...]:
    """A notice of reference constants outside their own bounds."""
    reference, unknowns = reference_constants(specimen), specimen.unknowns
    outside = tuple(
        (name, reference[name], unknowns[name].prior.lower, unknowns[name].prior.upper)
        for name in unknowns.names
        if name in specimen.material.constants
        and not unknowns[name].prior.lower <= reference[name] <= unknowns[name].prior.upper
    )
    return (Notice("reference_outside", "slip", {"outside": outside}),) if outside else ()


def count_slips(n_frequencies: int, n_unknowns: int) -> tuple[Notice, ...]:
    """A notice of fewer frequencies than unknowns."""
    if n_frequencies >= n_unknowns:
        return ()
    return (Notice("few_frequencies", "slip", {"frequencies": n_frequencies, "unknowns": n_unknowns}),)


def count_notices(n_frequencies: int, n_unknowns: int) -> tuple[Notice, ...]:
    """A notice of as many frequencies as unknowns, so that none is left over to judge the fit."""
    return (Notice("no_frequency_over", facts={"count": n_unknowns}),) if n_frequencies == n_unknowns else ()


def misfit_slips(level: float) -> tuple[Notice, ...]:
    """A notice of a misfit beyond any tap test; level : inferred noise, or rms residual with stated noise."""
    return (Notice("large_misfit", "slip", {"misfit": level}),) if level > HIGH_MISFIT else ()


def high_noise_notices(level: float) -> tuple[Notice, ...]:
    """A notice of an inferred relative noise above that of a usual tap test."""
    return (Notice("high_noise", facts={"noise": level}),) if level > USUAL_NOISE else ()


def misfit_over_noise(measurement: Measurement, residuals: Array, n_fitted: int) -> float:
    """The misfit as a multiple of the stated noise by `birge_ratio`; 1 where no noise is stated.

    residuals : (n,) predicted / measured - 1, nan where a frequency belongs to no mode. n_fitted : constants.
    """
    f, paired = measurement.frequencies, np.isfinite(residuals)
    if measurement.relative_std is None and measurement.frequency_sd is None:
        return 1.0
    noise = measurement.noise_sd(measurement.relative_std or 0.0)
    sd = np.sqrt(noise**2 + measurement.resolution**2 / 12.0) / f
    return birge_ratio(residuals[paired] / sd[paired], n_fitted)


def birge_ratio(standardised: Array, n_fitted: int) -> float:
    """A misfit as a multiple of the noise, 1 where the noise explains it or no frequency is left over.

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


def noise_slips(measurement: Measurement, residuals: Array, n_fitted: int) -> tuple[Notice, ...]:
    """A notice of a misfit that the stated noise does not explain; arguments as for `misfit_over_noise`."""
    times = misfit_over_noise(measurement, residuals, n_fitted)
    return () if times == 1.0 else (Notice("misfit_over_noise", "slip", {"times": times}),)


def contradicts_list(notices: Iterable[Notice]) -> bool:
    """Whether one of the notices says that the plate model does not describe the frequencies."""
    return any(notice.code in _CONTRADICTING for notice in notices)


def disagrees(plate: Plate) -> bool:
    """Whether thickness, mass and density of a plate contradict one another."""
    return plate.thicknesses_apart > _FAR_SD


def stated_slips(specimen: Specimen) -> tuple[Notice, ...]:
    """Notices of impossible statements: thickness, mass and density that disagree, too much noise."""
    found, plate = list[Notice](), specimen.plate
    if plate.thicknesses is not None and disagrees(plate):
        gauged, by_mass = plate.thicknesses
        facts = {"gauged": gauged, "by_mass": by_mass, "apart": plate.thicknesses_apart}
        facts["taken"] = (plate.thickness, plate.sd["thickness"])
        found.append(Notice("thicknesses_apart", "slip", facts))
    if specimen.measurement is not None:
        found += _noise_slips(specimen.measurement)
    return tuple(found)


def _noise_slips(measurement: Measurement) -> Iterator[Notice]:
    """A notice of a stated noise beyond any tap test: most likely per cent written as a fraction."""
    if measurement.frequency_sd is not None:
        relative = measurement.frequency_sd / measurement.frequencies
        at, level = int(np.argmax(relative)), float(np.mean(relative))
        most = (float(measurement.frequencies[at]), float(relative[at]))
        facts = {"noise": level, "source": measurement.sd_source, "most": most}
    elif measurement.relative_std is not None:
        level, facts = measurement.relative_std, {"noise": measurement.relative_std}
    else:
        return
    if level > HIGH_MISFIT:
        yield Notice("large_stated_noise", "slip", facts)


def common_factor_slips(
    specimen: Specimen, estimates: Mapping[str, tuple[float, float]]
) -> tuple[Notice, ...]:
    """A notice of all moduli far on one side of their references: most likely a wrong size, mass or scale.

    For a thin plate f^2 is proportional to E h^2 / rho, or E h^3 / m. None for a plate whose stated numbers
    disagree: one of them is wrong.

    estimates : modulus that the frequencies determine -> its estimate and standard deviation, Pa, without its
    reference as prior
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
    if not (above or below) or disagrees(specimen.plate):
        return ()
    is_common = max(ratios.values()) <= _COMMON * min(ratios.values())
    facts = {
        "distances": tuple(distances.items()),
        "ratio": float(np.exp(np.mean(np.log(list(ratios.values()))))) if is_common else None,
        "thickness": specimen.plate.thickness,
        "weighed": specimen.plate.mass is not None,
    }
    return (Notice("common_factor", "slip", facts),)


def reference_contradictions(
    specimen: Specimen, determined: Mapping[str, tuple[float, float]], answer: Iterable[Constant]
) -> tuple[Notice, ...]:
    """`common_factor_slips`, or else a notice of constants that contradict their priors and distort others.

    determined : its ``estimates``. answer : all constants, and other unknowns
    """
    if common := common_factor_slips(specimen, determined):
        return common
    far = []
    for constant in answer:
        name = constant.name
        known = constant.prior.describe() if name in specimen.unknowns else None
        if known is not None and known.centre is not None:
            distance = (constant.value - known.centre) / float(np.hypot(known.scale, constant.sd))
            far += [(name, distance)] if abs(distance) > _CONTRADICTED_SD else []
    return (Notice("far_reference", "slip", {"distances": tuple(far)}),) if far else ()


def equal_list_slips(specimens: Sequence[Specimen]) -> tuple[Notice, ...]:
    """Notices of plates whose lists are so nearly equal that they are most likely one measurement."""
    slips = []
    for i, first in enumerate(specimens):
        for second in specimens[i + 1 :]:
            a, b = first.measurement, second.measurement
            if a is None or b is None or a.size != b.size:
                continue
            apart = float(np.max(np.abs(b.frequencies / a.frequencies - 1.0)))
            if apart <= _EQUAL:
                facts = {"plates": (first.name, second.name), "apart": apart}
                slips.append(Notice("equal_lists", "slip", facts))
    return tuple(slips)


def error_notices(error: Array, limit: float = LARGE_ERROR) -> tuple[Notice, ...]:
    """A notice if the solver's estimated relative error (n_modes,) is above a limit."""
    worst = float(np.max(error))
    if not worst > limit:
        return ()
    return (Notice("solver_error", facts={"error": worst, "mode": int(np.argmax(error)) + 1}),)
