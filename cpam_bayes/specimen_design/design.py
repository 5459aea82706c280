"""Which specimen and test would determine the constants of a material: the question `design`."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Final

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.arguments import checked
from cpam_bayes.errors import PlateFileError
from cpam_bayes.forward_model.air_shift import air_shifts
from cpam_bayes.forward_model.preconditions import (
    MAX_MODES,
    require_number,
    require_seed,
    require_supported,
    require_whole,
)
from cpam_bayes.forward_model.solve import measured_modes
from cpam_bayes.identification.verdicts import Verdict, verdict_of
from cpam_bayes.mechanics.modes import RigidBodyError
from cpam_bayes.parallel import counted, open_executor, run
from cpam_bayes.plate import PlateLike, Specimen, read_plate, user_name
from cpam_bayes.result import SILENT, PlateResult, Watch
from cpam_bayes.specimen_design.candidates import Geometry, geometries, specimen_of
from cpam_bayes.specimen_design.information import (
    Expected,
    Response,
    Test,
    expected_information,
    prior_sd,
    response_of,
)

__all__ = ["Candidate", "DesignResult", "design"]

Array = NDArray[Any]

USUAL_STD: Final = 0.005
"""Repeatability of a usual tap test, taken where neither the plate file nor the caller gives one."""
MAX_STD: Final = 0.3
MAX_RATIO: Final = 20.0
MAX_THICKNESS_MM: Final = 1000.0
MAX_GEOMETRIES: Final = 2000
# Modes beyond those of the plate as it is measured.
_MORE_MODES: Final = (0, 5, 10)
_STDS: Final = tuple(step * 10.0**power for power in (-2, -3, -4, -5) for step in (5.0, 2.0, 1.0))
_NO_MESH: Final = "design computes rectangular plates only; leave mesh out"


@dataclass(frozen=True, slots=True)
class Candidate:
    """A specimen with a number of modes, and what its list would say.

    is_present : whether it is the plate as it is, with as many modes as were measured, or 10
    information : about the constants asked for, nats
    """

    geometry: Geometry
    n_modes: int
    is_present: bool
    expected: Expected

    @property
    def information(self) -> float:
        """About the constants asked for, nats."""
        return self.expected.information

    @property
    def description(self) -> str:
        """Size, layup, edges and number of modes."""
        g = self.geometry
        layup = f"{g.layup.text}, " if g.layup.n_plies > 1 else ""
        return (
            f"{1e3 * g.length:.4g} x {1e3 * g.width:.4g} x {1e3 * g.thickness:.4g} mm, {layup}{g.edges}, "
            f"{self.n_modes} mode{'' if self.n_modes == 1 else 's'}"
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class DesignResult(PlateResult):
    """Specimens by what they would say about the constants, the best first.

    Attributes
    ----------
    constants : the unknowns of the plate file
    asked : those that the information is about
    prior_sd : (n,) standard deviations of their priors, SI
    test : how frequencies would be measured
    noise_is_usual : whether the repeatability is that of a usual tap test, for want of a stated one
    candidates : the most informative first
    needed_std : the least good repeatability with which the first of them determines the constants asked for,
        None where none does
    failed : specimens that cannot be computed, and why
    seconds : wall clock
    """

    question: ClassVar[str] = "design"
    command: ClassVar[str] = "design"

    constants: tuple[str, ...]
    asked: tuple[str, ...]
    prior_sd: Array
    test: Test
    noise_is_usual: bool
    candidates: tuple[Candidate, ...]
    needed_std: float | None
    failed: tuple[tuple[Geometry, str], ...]
    seconds: float

    @property
    def present(self) -> Candidate | None:
        """The plate as it is, if it can be computed."""
        return next((c for c in self.candidates if c.is_present), None)

    def verdicts(self, candidate: Candidate) -> Mapping[str, Verdict]:
        """Who would determine each constant."""
        sds = zip(self.constants, candidate.expected.sd, self.prior_sd, strict=True)
        return {name: verdict_of(float(sd), float(prior), explained=True) for name, sd, prior in sds}


@checked
def design(
    plate: PlateLike,
    *,
    constants: Sequence[str] | None = None,
    layups: Sequence[str] | None = None,
    ratios: Sequence[float] | None = None,
    thicknesses_mm: Sequence[float] | None = None,
    edges: Sequence[str] | None = None,
    modes: Sequence[int] | None = None,
    relative_std: float | None = None,
    seed: int = 0,
    executor: str = "serial",
    workers: int | None = None,
    watch: Watch = SILENT,
) -> DesignResult:
    """Which layup, shape, thickness, edges and number of modes would determine the constants.

    Every combination is computed at the reference constants. Its expected information about the constants is
    that of Laplace's approximation there, with the priors of [unknowns], and the standard deviations of
    [plate.sd] integrated over: see `expected_information`. It compares specimens; what a list that was
    measured says is the answer of `identify`.

    Parameters
    ----------
    plate : what `read_plate` takes, or what it returns; with [unknowns], a measurement is not needed
    constants : those that the information is about, by their names in [unknowns]; all where left out
    layups : in the notation of plate files; left out: the plate's, and usual ones of as many plies
    ratios : of length to width, at the area of the plate; left out: the plate's, and 0.5 to 2.8
    thicknesses_mm : left out: the plate's
    edges : four letters each; left out: the plate's, FFFF and CFFF
    modes : numbers of the lowest modes in the list; left out: as many as were measured, or 10, and 5 and 10
        more
    relative_std : repeatability of a frequency; left out: that of the plate file, or 0.005
    executor, workers : where the work is done, see `cpam_bayes.parallel.open_executor`
    watch : is shown the progress

    Raises
    ------
    ValueError
        If the plate cannot be read, has no unknowns, or an argument is out of range.

    Examples
    --------
    >>> import cpam_bayes as cb
    >>> found = cb.design("A1", edges=["FFFF"], ratios=[1.0, 2.0], modes=[6])
    >>> [round(c.information, 1) for c in found.candidates] == sorted(
    ...     [round(c.information, 1) for c in found.candidates], reverse=True
    ... )
    True
    """
    require_seed(seed)
    start = time.perf_counter()
    specimen = require_supported(read_plate(plate), _NO_MESH)
    unknowns = specimen.unknowns
    if not unknowns.size:
        raise PlateFileError(
            f"{specimen.source}: [unknowns] is missing; name the constants to be determined, with bounds"
        )
    asked = _asked(specimen, constants)
    numbers = _numbers(specimen, modes)
    for name, values, most in (
        ("ratios", ratios, MAX_RATIO),
        ("thicknesses_mm", thicknesses_mm, MAX_THICKNESS_MM),
        ("relative_std", None if relative_std is None else (relative_std,), MAX_STD),
    ):
        for value in values or ():
            require_number(name, value, most)
    made = geometries(specimen, layups=layups, ratios=ratios, thicknesses_mm=thicknesses_mm, edges=edges)
    if len(made) > MAX_GEOMETRIES:
        raise ValueError(f"{len(made)} specimens, accepted: {MAX_GEOMETRIES} at most; vary less at a time")
    test, usual = _test(specimen, relative_std)
    with (
        open_executor(executor, workers) as pool,
        watch.stage(f"design {specimen.name}", len(made), lambda done: "specimens") as shown,
    ):
        done = counted(lambda n, total: shown.tick(n, float(n)), len(made))
        responses = run(_response, (specimen, max(numbers)), made, pool, on_result=done)
    prior = prior_sd(unknowns)
    wanted = np.array([name in asked for name in unknowns.names])
    n_present = measured_modes(specimen)
    candidates = [
        Candidate(g, n, g.is_present and n == n_present, expected_information(r, n, test, prior, wanted))
        for g, r in zip(made, responses, strict=True)
        if isinstance(r, Response)
        for n in numbers
    ]
    if not candidates:
        raise PlateFileError(f"{specimen.source}: none of the specimens can be computed: {responses[0]}")
    ranked = sorted(candidates, key=lambda c: -c.information)
    by_geometry = dict(zip(map(id, made), responses, strict=True))
    response = by_geometry[id(ranked[0].geometry)]
    assert isinstance(response, Response)
    return DesignResult(
        seed=seed,
        specimen=specimen,
        air_shifts=air_shifts(specimen),
        constants=unknowns.names,
        asked=asked,
        prior_sd=prior,
        test=test,
        noise_is_usual=usual,
        candidates=tuple(ranked),
        needed_std=_needed_std(response, ranked[0].n_modes, test, prior, wanted),
        failed=tuple((g, r) for g, r in zip(made, responses, strict=True) if isinstance(r, str)),
        seconds=time.perf_counter() - start,
    )


def _response(shared: tuple[Specimen, int], geometry: Geometry) -> Response | str:
    """The frequencies of a specimen, or why there are none."""
    specimen, n_modes = shared
    try:
        return response_of(specimen_of(specimen, geometry), n_modes)
    except (RigidBodyError, ValueError) as error:
        return str(error)


def _needed_std(response: Response, n_modes: int, test: Test, prior: Array, asked: Array) -> float | None:
    """The largest repeatability, of 1, 2 and 5 times powers of ten, by which the data determine all asked."""
    for std in _STDS:
        sd = expected_information(response, n_modes, Test(std, test.resolution), prior, asked).sd
        verdicts = [
            verdict_of(float(s), float(p), explained=True)
            for s, p in zip(sd[asked], prior[asked], strict=True)
        ]
        if all(v == "determined by the data" for v in verdicts):
            return std
    return None


def _asked(specimen: Specimen, constants: Sequence[str] | None) -> tuple[str, ...]:
    """The constants that the information is about, in the order of [unknowns]."""
    names = specimen.unknowns.names
    if constants is None:
        return names
    by_name = {user_name(name): name for name in names} | {name: name for name in names}
    unknown = [name for name in constants if name not in by_name]
    if unknown or not constants:
        raise ValueError(
            f"constants: received {' '.join(unknown) or 'none'}, accepted: {' '.join(map(user_name, names))}"
        )
    wanted = {by_name[name] for name in constants}
    return tuple(name for name in names if name in wanted)


def _numbers(specimen: Specimen, modes: Sequence[int] | None) -> tuple[int, ...]:
    """Numbers of modes, ascending."""
    if modes is None:
        n = measured_modes(specimen)
        return tuple(dict.fromkeys(min(n + more, MAX_MODES) for more in _MORE_MODES))
    if not modes:
        raise ValueError("modes: received none, accepted: numbers of modes")
    for n in modes:
        require_whole("modes", n, 1, MAX_MODES)
    return tuple(sorted(set(modes)))


def _test(specimen: Specimen, relative_std: float | None) -> tuple[Test, bool]:
    """How frequencies would be measured, and whether its noise is that of a usual tap test."""
    measurement = specimen.measurement
    resolution = 0.0 if measurement is None else measurement.resolution
    if relative_std is not None:
        return Test(relative_std, resolution), False
    if measurement is not None and measurement.frequency_sd is not None:
        return Test(float(np.mean(measurement.frequency_sd / measurement.frequencies)), resolution), False
    if measurement is not None and measurement.relative_std is not None:
        return Test(measurement.relative_std, resolution), False
    return Test(USUAL_STD, resolution), True
