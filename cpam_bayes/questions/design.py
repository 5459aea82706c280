"""The question `design`: specimens and tests ranked by how well they would determine the constants."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any, ClassVar, Final

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.answer import Verdict
from cpam_bayes.command import EXECUTOR, MAX_MODES, PLATE, WORKERS, Command, option, positive, whole
from cpam_bayes.errors import PlateFileError, checked
from cpam_bayes.formatting import listed, significant
from cpam_bayes.forward_model.known_errors import known_errors
from cpam_bayes.forward_model.labels import measured_modes
from cpam_bayes.forward_model.model import air_shifts, with_references
from cpam_bayes.forward_model.preconditions import (
    rectangular_only,
    require_number,
    require_seed,
    require_supported,
    require_whole,
)
from cpam_bayes.identification.point import verdict_of
from cpam_bayes.identification.specimen_design import (
    USUAL_STD,
    Candidate,
    Geometry,
    Response,
    Test,
    expected_information,
    geometries,
    measured_like,
    needed_std,
    response_of,
    specimen_of,
)
from cpam_bayes.mechanics.modes import RigidBodyError
from cpam_bayes.parallel import counted, open_executor, run
from cpam_bayes.plate import PlateLike, Specimen, read_plate, to_user, unit_of, user_name
from cpam_bayes.plate.edges import conditions
from cpam_bayes.render.figures import headed, new_figure
from cpam_bayes.render.plate import plate_section
from cpam_bayes.render.report import (
    COMPUTATION,
    Caption,
    Column,
    Drawing,
    Report,
    Rows,
    Section,
    facts,
    plate_keys,
)
from cpam_bayes.render.sentences import plate_argument
from cpam_bayes.result import PlateResult, present
from cpam_bayes.running import SILENT, Watch

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Array = NDArray[Any]
Value = Callable[[Candidate], float]

MAX_STD: Final = 0.3
MAX_RATIO: Final = 20.0
MAX_THICKNESS_MM: Final = 1000.0
MAX_GEOMETRIES: Final = 2000
# Modes beyond the number measured.
_MORE_MODES: Final = (0, 5, 10)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class DesignResult(PlateResult):
    """Specimens ranked by expected information about the constants, the best first.

    Attributes
    ----------
    constants : the unknowns of the plate file
    asked : those that the information is about
    prior_sd : (n,) standard deviations of their priors, SI
    test : how frequencies would be measured
    noise_is_usual : whether the repeatability is that of a usual tap test, because none is stated
    candidates : the most informative first
    needed_std : the largest repeatability at which the first candidate determines the constants asked for,
        None if it does at none
    failed : specimens that cannot be computed, and why
    seconds : wall clock
    """

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
        """The candidate that is the plate as it is, if it can be computed."""
        return next((c for c in self.candidates if c.is_present), None)

    def verdicts(self, candidate: Candidate) -> Mapping[str, Verdict]:
        """What would determine each constant."""
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
    """Layups, shapes, thicknesses, edges and numbers of modes, ranked by how well they determine constants.

    Every combination is computed at the reference constants. Its expected information follows from Laplace's
    approximation there, with the same prior as in every command. Errors of sizes, mass and frequency
    scale, stated or usual, and the compliance of clamps are integrated over, see `expected_information`. This
    compares specimens; for a measured list see `identify`.

    Parameters
    ----------
    plate : a built-in name, a path, a table or a `Specimen`, see `read_plate`, with [unknowns];
        a measurement is not needed
    constants : those that the information is about, by their names in [unknowns]; all if left out
    layups : in the notation of plate files; if left out, the plate's, and usual ones with as many plies
    ratios : length / width, at the area of the plate; if left out, the plate's, and 0.5 to 2.8
    thicknesses_mm : if left out, the plate's
    edges : four letters each; if left out, the plate's, FFFF and CFFF
    modes : numbers of lowest modes listed; if left out, as many as were measured, or 10, and 5 and 10
        more
    relative_std : repeatability of a frequency; if left out, that of the plate file, or 0.005
    executor, workers : where the work is done, see `cpam_bayes.parallel.open_executor`
    watch : progress display; none if left out

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
    specimen = with_references(require_supported(read_plate(plate), rectangular_only("design")))
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
    test, usual = measured_like(specimen, relative_std)
    with (
        open_executor(executor, workers) as pool,
        watch.stage(f"design {specimen.name}", len(made), counted="specimens") as shown,
    ):
        done = counted(lambda n, total: shown.tick(n, float(n)), len(made))
        responses = run(_response, (specimen, max(numbers)), made, pool, on_result=done)
    prior = unknowns.prior_sd
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
        needed_std=needed_std(response, ranked[0].n_modes, test, prior, wanted),
        failed=tuple((g, r) for g, r in zip(made, responses, strict=True) if isinstance(r, str)),
        seconds=time.perf_counter() - start,
    )


def _response(shared: tuple[Specimen, int], geometry: Geometry) -> Response | str:
    """Frequencies of a specimen, or the reason why there are none."""
    specimen, n_modes = shared
    try:
        return response_of(specimen_of(specimen, geometry), n_modes)
    except (RigidBodyError, ValueError) as error:
        return str(error)


def _asked(specimen: Specimen, constants: Sequence[str] | None) -> tuple[str, ...]:
    """The constants asked for, in the order of [unknowns]."""
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


# Candidates on the first screen and in the table behind it.
_SHOWN: Final = 8
_MOST_ROWS: Final = 60


def _determined(result: DesignResult, candidate: Candidate) -> list[str]:
    return [name for name, verdict in result.verdicts(candidate).items() if verdict is Verdict.DATA]


def _by_name(result: DesignResult, values: Any) -> dict[str, float]:
    return {user_name(n): to_user(n, float(v)) for n, v in zip(result.constants, values, strict=True)}


def _rows(result: DesignResult, candidates: Sequence[Candidate]) -> Rows:
    """The candidates with the standard deviation of every constant that each would give."""

    def sd(k: int, name: str) -> Column:
        unit = f", {unit_of(name)}" if unit_of(name) else ""
        return Column(
            f"sd of {name}{unit}",
            f"sd_{user_name(name)}",
            lambda c: to_user(name, float(c.expected.sd[k])),
            lambda v: significant(v, 2),
            number=True,
        )

    columns = (
        Column("specimen", "description", lambda c: c.description),
        Column("nats", "information_nats", lambda c: c.information, lambda v: f"{v:.2f}", number=True),
        *(sd(k, name) for k, name in enumerate(result.constants)),
        Column("determines", None, lambda c: " ".join(_determined(result, c)) or "none"),
        Column(None, "length_mm", lambda c: to_user("length", c.geometry.length)),
        Column(None, "width_mm", lambda c: to_user("width", c.geometry.width)),
        Column(None, "thickness_mm", lambda c: to_user("thickness", c.geometry.thickness)),
        Column(
            None, "layup", lambda c: None if result.specimen.material.isotropic else c.geometry.layup.text
        ),
        Column(None, "edges", lambda c: c.geometry.edges),
        Column(None, "modes", lambda c: c.n_modes),
        Column("", "is_present", lambda c: c.is_present, lambda v: "as it is" if v else ""),
    )
    return Rows("candidates", columns, tuple(candidates), lambda c: c.is_present)


_FAILED: Final = (
    Column("layup", "layup", lambda f: f[0].layup.text),
    Column("edges", "edges", lambda f: f[0].edges),
    Column("length / width", "ratio", lambda f: f[0].ratio, lambda v: f"{v:.3g}", number=True),
    Column("why", "message", lambda f: f[1]),
)


@present.register
def _present(result: DesignResult) -> Report:
    every, best = _rows(result, result.candidates), result.candidates[0]
    shown = list(result.candidates[:_SHOWN])
    if result.present is not None and result.present not in shown:
        shown.append(result.present)
    failed = Rows("failed", _FAILED, result.failed, lambda f: True)
    n = len(result.candidates)
    title = "All candidates" if n <= _MOST_ROWS else f"The {_MOST_ROWS} best of {n} candidates"
    maps = tuple(_maps(result))
    behind = _rows(result, result.candidates[:_MOST_ROWS]).table(title)
    return Report(
        summary=result.screen(
            headline=f"{_verdict(result, best)}{_gain(result)}",
            tables=(_rows(result, shown).table(f"The best of {n} candidates"),),
            lines=(_noise(result), _sizes(result)),
            next_step=_next_step(result),
        ),
        sections=(
            Section("Maps of the expected information", (), tuple(m.name for m in maps), folded=False),
            plate_section(result.specimen, result.air_shifts),
            Section(title, (behind, failed.table("Specimens that cannot be computed"))),
            Section(COMPUTATION, (facts("Computation", _computation(result)),)),
        ),
        document={
            **plate_keys(result.command, result.seed, result.specimen),
            "constants": [user_name(name) for name in result.asked],
            "prior_sd": _by_name(result, result.prior_sd),
            "relative_std": result.test.relative_std,
            "relative_std_is_usual": result.noise_is_usual,
            "relative_std_needed": result.needed_std,
            "resolution_hz": result.test.resolution,
            "candidates": [_keys(result, *each) for each in zip(every.rows, every.records(), strict=True)],
            "failed": failed.records(),
            "seconds": result.seconds,
            "warnings": list(result.warnings),
            "notes": list(result.specimen.notes),
        },
        drawings=maps,
        rows=(every, failed),
    )


def _keys(result: DesignResult, candidate: Candidate, record: Mapping[str, Any]) -> dict[str, Any]:
    """A candidate in the document, with one object per quantity that is keyed by constant."""
    flat = {f"sd_{user_name(name)}" for name in result.constants}
    return {
        **{key: value for key, value in record.items() if key not in flat},
        "sd": _by_name(result, candidate.expected.sd),
        "information_by_constant": {
            user_name(name): float(nats)
            for name, nats in zip(result.constants, candidate.expected.each, strict=True)
        },
        "verdict": {user_name(n): verdict.value for n, verdict in result.verdicts(candidate).items()},
    }


def _verdict(result: DesignResult, best: Candidate) -> str:
    """Headline: the requested constants that the best candidate determines, and those left open."""
    determined = _determined(result, best)
    yes = [name for name in result.asked if name in determined]
    no = [name for name in result.asked if name not in determined]
    spread = dict(zip(result.constants, best.expected.sd, strict=True))
    told = [
        f"{name} to within {significant(2 * to_user(name, float(spread[name])), 2)} {unit_of(name)}".rstrip()
        for name in yes
    ]
    if not yes:
        return f"None of the specimens determines {listed(no, 'or')}; best: {best.description}."
    left = f"; {listed(no, 'and')} {'stays' if len(no) == 1 else 'stay'} open" if no else ""
    return f"Best: {best.description}, which would determine {listed(told, 'and')}{left}."


def _gain(result: DesignResult) -> str:
    present = result.present
    if present is None or present is result.candidates[0]:
        return ""
    more = significant(result.candidates[0].information - present.information, 2)
    many = "1 mode" if present.n_modes == 1 else f"{present.n_modes} modes"
    return f" That is {more} nats more than {many} of the plate as it is."


def _noise(result: DesignResult) -> str:
    percent = significant(100.0 * result.test.relative_std, 2)
    source = "usual for a tap test" if result.noise_is_usual else "as stated"
    rounding = f"; resolution {result.test.resolution:g} Hz" if result.test.resolution else ""
    return f"Repeatability of a frequency: {percent} %, {source}{rounding}."


def _sizes(result: DesignResult) -> str:
    sizes = [name.replace("_", " ") for name in known_errors(result.specimen)]
    clamps = any(edge.is_clamp for c in result.candidates for edge in conditions(c.geometry.edges))
    within = listed([*sizes, *(["clamp compliance"] if clamps else [])], "and")
    return f"The standard deviations contain noise and errors of {within}."


def _next_step(result: DesignResult) -> str:
    best, asked = result.candidates[0], listed(list(result.asked), "and")
    if all(name in _determined(result, best) for name in result.asked):
        identify = f"cpam-bayes identify {plate_argument(result.specimen)}"
        made = "measure the plate" if best.is_present else "make the specimen, measure it"
        return f"{made} ({best.n_modes} lowest modes) and identify its constants, as in {identify}"
    if result.needed_std is not None:
        return (
            f"measure more precisely: the best specimen determines {asked} at a repeatability of "
            f"{significant(100.0 * result.needed_std, 1)} %."
        )
    return (
        "ask for more modes, or give a prior from a tensile test: the best specimen determines "
        f"{asked} at no repeatability."
    )


def _computation(result: DesignResult) -> tuple[tuple[str, str], ...]:
    return (
        ("model", "Ritz, first-order shear deformation, at the reference constants"),
        (
            "information",
            "Laplace's approximation: Fisher information of the list and the priors. It "
            "compares specimens; intervals come from `identify`",
        ),
        ("specimens", f"{len({id(c.geometry) for c in result.candidates})} computed"),
        ("time", f"{result.seconds:.1f} s"),
    )


_COLOURS: Final = "Blues"
# Fraction of the greatest value from which a cell is dark, and its number white.
_DARK: Final = 0.6


def _maps(result: DesignResult) -> list[Drawing]:
    """One map for all constants asked for, and one for each constant."""
    asked = listed(list(result.asked), "and")
    about: list[tuple[str, str, Value]] = [("information", asked, lambda c: c.information)]
    if len(result.constants) > 1:
        about += [
            (name, name, lambda c, k=k: float(c.expected.each[k]))  # type: ignore[misc]
            for k, name in enumerate(result.constants)
        ]
    return [
        Drawing(
            name,
            partial(_map, result, what, value),
            Caption(
                f"Darker: the frequencies of this specimen would say more about {what}. The number is the "
                "expected information in nats; for one constant, 1.2 nats cut its standard deviation to a "
                "third of the prior's: it counts as determined. Frame: the plate as it is. Star: the best.",
                f"Expected information about {what} by layup and length / width, a panel for each edge "
                "condition and number of modes.",
            ),
        )
        for name, what, value in about
    ]


def _map(result: DesignResult, what: str, value: Value) -> Figure:
    """Map of layup (up) and length / width (right), a row of panels for each edges and thickness."""
    candidates = result.candidates
    tests = list(dict.fromkeys(sorted((_held(c.geometry) for c in candidates), key=str)))
    numbers = sorted({c.n_modes for c in candidates})
    layups = list(dict.fromkeys(c.geometry.layup.text for c in sorted(candidates, key=_place)))
    ratios = sorted({round(c.geometry.ratio, 3) for c in candidates})
    top = max(max(value(c) for c in candidates), 1e-3)
    best = max(candidates, key=value)
    size = (1.5 + len(numbers) * (0.42 * len(ratios) + 0.5), 1.5 + len(tests) * (0.32 * len(layups) + 0.7))
    figure = new_figure(max(size[0], 5.2), max(size[1], 2.8))
    grid = figure.subplots(len(tests), len(numbers), squeeze=False, sharex=True, sharey=True)
    image: Any = None
    for row, held in zip(grid, tests, strict=True):
        for axes, n in zip(row, numbers, strict=True):
            here = [c for c in candidates if _held(c.geometry) == held and c.n_modes == n]
            image = _panel(axes, here, layups, ratios, value, top)
            _mark(axes, here, layups, ratios, best)
            axes.set_title(f"{held[0]}, {1e3 * held[1]:.4g} mm, {n} modes", fontsize=9)
    for axes in grid[-1]:
        axes.set_xticks(range(len(ratios)), [f"{r:.3g}" for r in ratios], fontsize=8)
        axes.set_xlabel("length / width", fontsize=9)
    for axes in grid[:, 0]:
        axes.set_yticks(range(len(layups)), layups, fontsize=8)
    figure.colorbar(image, ax=grid, label="expected information, nats", shrink=0.9)
    headed(figure, f"Expected information about {what}: material of {result.specimen.name}")
    return figure


def _panel(
    axes: Axes, here: list[Candidate], layups: list[str], ratios: list[float], value: Value, top: float
) -> Any:
    cells = np.full((len(layups), len(ratios)), np.nan)
    for c in here:
        cells[_cell(c, layups, ratios)] = value(c)
    image = axes.imshow(cells, cmap=_COLOURS, vmin=0.0, vmax=top, aspect="auto", origin="lower")
    for (i, j), v in np.ndenumerate(cells):
        if np.isfinite(v):
            colour = "white" if v > _DARK * top else "black"
            axes.text(j, i, f"{v:.1f}" if top >= 1.0 else f"{v:.2f}", ha="center", va="center",
                      fontsize=8, color=colour)  # fmt: skip
    return image


def _mark(axes: Axes, here: list[Candidate], layups: list[str], ratios: list[float], best: Candidate) -> None:
    """Mark the plate as it is by a frame, the best specimen by a star."""
    for c in here:
        i, j = _cell(c, layups, ratios)
        if c.is_present:
            frame = np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5], [-0.5, -0.5]])
            axes.plot(j + frame[:, 0], i + frame[:, 1], color="#c1440e", linewidth=2, clip_on=False, zorder=4)
        if c is best:
            axes.plot(
                j + 0.36, i + 0.32, "*", color="#e8a33d", markeredgecolor="black", markersize=9, zorder=5
            )


def _cell(c: Candidate, layups: list[str], ratios: list[float]) -> tuple[int, int]:
    return layups.index(c.geometry.layup.text), ratios.index(round(c.geometry.ratio, 3))


def _held(geometry: Geometry) -> tuple[str, float]:
    """Edges and thickness, common to a row of panels."""
    return geometry.edges, geometry.thickness


def _place(c: Candidate) -> tuple[bool, str]:
    """Sort key of layups: that of the plate first, the others by notation."""
    return not c.geometry.is_present, c.geometry.layup.text


COMMAND: Final = Command(
    design,
    (
        PLATE,
        option(
            "--constants",
            nargs="+",
            metavar="NAME",
            help="constants to be determined, such as nu12 (default: all of [unknowns])",
        ),
        option(
            "--layups",
            nargs="+",
            metavar="LAYUP",
            help='such as "[0_8]" "[0/90]_2s" (default: that of the plate, and usual ones of as many plies)',
        ),
        option(
            "--ratios",
            nargs="+",
            type=positive(MAX_RATIO),
            metavar="R",
            help="length over width, at the area of the plate (default: that of the plate, and 0.5 to 2.8)",
        ),
        option(
            "--thicknesses",
            "thicknesses_mm",
            nargs="+",
            type=positive(MAX_THICKNESS_MM),
            metavar="MM",
            help="thicknesses in mm (default: that of the plate)",
        ),
        option(
            "--edges", nargs="+", metavar="EDGES", help="such as FFFF CFFF (default: those, and the plate's)"
        ),
        option(
            "--modes",
            nargs="+",
            type=whole(1, MAX_MODES),
            metavar="N",
            help=f"numbers of the lowest modes in the list, 1 to {MAX_MODES} (default: as many as were "
            "measured, or 10, and 5 and 10 more)",
        ),
        option(
            "--relative-std",
            type=positive(MAX_STD),
            metavar="S",
            help="repeatability of a frequency, as in a plate file (default: that of the plate file, or "
            f"{USUAL_STD})",
        ),
        EXECUTOR,
        WORKERS,
    ),
)
