"""The question `new`: a commented plate file from what is known of a plate, or from answers at a terminal.

Unknown entries stand in the file as comments with examples.
"""

from __future__ import annotations

import argparse
import json
import math
import shlex
import sys
import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, ClassVar, Final

from cpam_bayes import __version__
from cpam_bayes.command import Command, option, positive
from cpam_bayes.errors import PlateFileError, checked
from cpam_bayes.formatting import listed
from cpam_bayes.forward_model.model import ROOM_AIR
from cpam_bayes.forward_model.preconditions import require_choice
from cpam_bayes.plate.edges import ALL_FREE, EDGE_KEY, PLACES
from cpam_bayes.plate.reader import parse_specimen
from cpam_bayes.plate.text import UNITS, number_of, numbers_of
from cpam_bayes.questions.forward import handling_before
from cpam_bayes.render.handling import Handling
from cpam_bayes.render.report import Report, Summary, remarks
from cpam_bayes.result import Result, present
from cpam_bayes.storage import replaceable, write_whole


@dataclass(frozen=True, slots=True)
class TypicalMaterial:
    """Typical constants of a kind of material.

    bounds : of the search, wide enough for the kind. source : where the constants are from
    """

    name: str
    symmetry: str
    constants: Mapping[str, float]
    bounds: Mapping[str, tuple[float, float]]
    source: str


MATERIALS: Final[Mapping[str, TypicalMaterial]] = {
    "carbon": TypicalMaterial(
        "carbon/epoxy",
        "transversely_isotropic",
        {"E1_GPa": 121.2, "E2_GPa": 9.34, "nu12": 0.23, "G12_GPa": 6.25},
        {"E1_GPa": (60.0, 250.0), "E2_GPa": (4.0, 16.0), "nu12": (0.1, 0.45), "G12_GPa": (2.0, 10.0)},
        "Table 3 of the paper",
    ),
    "glass": TypicalMaterial(
        "glass/epoxy",
        "transversely_isotropic",
        {"E1_GPa": 40.1, "E2_GPa": 8.9, "nu12": 0.23, "G12_GPa": 4.23},
        {"E1_GPa": (20.0, 60.0), "E2_GPa": (4.0, 18.0), "nu12": (0.1, 0.45), "G12_GPa": (2.0, 8.0)},
        "Table 3 of the paper",
    ),
    "fabric": TypicalMaterial(
        "carbon fabric/epoxy",
        "orthotropic",
        {"E1_GPa": 60.0, "E2_GPa": 60.0, "nu12": 0.05, "G12_GPa": 4.0},
        {"E1_GPa": (30.0, 90.0), "E2_GPa": (30.0, 90.0), "nu12": (0.0, 0.3), "G12_GPa": (2.0, 8.0)},
        "round numbers for a balanced weave",
    ),
    "spruce": TypicalMaterial(
        "spruce",
        "orthotropic",
        {"E1_GPa": 11.0, "E2_GPa": 0.8, "nu12": 0.4, "G12_GPa": 0.7},
        {"E1_GPa": (5.0, 20.0), "E2_GPa": (0.2, 2.0), "nu12": (0.0, 0.9), "G12_GPa": (0.3, 1.5)},
        "round numbers for a quarter-sawn board",
    ),
    "metal": TypicalMaterial(
        "aluminium",
        "isotropic",
        {"E1_GPa": 69.0, "nu12": 0.33},
        {"E1_GPa": (20.0, 250.0), "nu12": (0.15, 0.45)},
        "Table 3 of the paper",
    ),
}
"""Materials by their name on the command line."""
_FIRST_MATERIAL: Final = next(iter(MATERIALS))
# Bounds that exclude a data-sheet constant are widened by this fraction of it, two standard deviations of
# the usual prior; Poisson's ratio of an isotropic material stays below one half.
_ROOM, _LARGEST_NU = 0.5, 0.495


@dataclass(frozen=True, slots=True)
class KnownPlate:
    """The known entries of a plate file; None or empty if unknown.

    size_mm : length, width, thickness. mass_g : weighed. material : a name in `MATERIALS`.
    constants : of the data sheet, in the order of the material's; is_typical : whether typical ones replace
    them, and only the bounds count.
    frequencies_hz : ascending; table : path of a table of modes instead.
    """

    name: str
    size_mm: Sequence[float] | None = None
    mass_g: float | None = None
    layup: str | None = None
    edges: str | None = None
    material: str = "carbon"
    constants: Sequence[float] = ()
    is_typical: bool = False
    thickness_sd_mm: float | None = None
    accelerometer: Sequence[float] | None = None
    air_density_kg_m3: float | None = None
    frequencies_hz: Sequence[float] = ()
    table: str | None = None


def plate_file_text(known: KnownPlate) -> str:
    """Text of a plate file; unknown keys are comments, so that reading it reports all that is missing."""
    material = MATERIALS[known.material]
    isotropic = material.symmetry == "isotropic"
    length, width, thickness = known.size_mm or (None, None, None)
    plate = [
        _line("length_mm", length, 310.0, "along x, the direction of a ply at 0 deg"),
        _line("width_mm", width, 228.0, "along y"),
        _line("thickness_mm", thickness, 3.1, "the mean of several places"),
        _line("mass_g", known.mass_g, 340.7, "weighed, nothing attached"),
        *(
            []
            if isotropic
            else [_line("layup", known.layup, "[0_8]", 'bottom to top; "?" is an unknown angle')]
        ),
        _line(
            "edges",
            known.edges,
            ALL_FREE,
            f"{', '.join(PLACES)}: {EDGE_KEY}",
        ),
    ]
    measured = [
        _line(
            "frequencies_hz",
            list(known.frequencies_hz) or None,
            [80.2, 146.3, 218.6],
            "ascending, from the first",
        ),
        _line("table", known.table, "modes.csv", "instead: columns mode, hz, optionally hit, sd, damping"),
    ]
    if known.table is not None or known.frequencies_hz:
        measured = [line for line in measured if not line.startswith("#")]
    of_material, unknown = (
        material_lines(material) if known.is_typical else _stated_lines(material, known.constants)
    )
    blocks = [
        [f"name = {json.dumps(known.name, ensure_ascii=False)}"],
        ["[plate]", *plate],
        [
            "# uncertainty of sizes and mass, which the intervals of the constants then contain",
            "[plate.sd]" if known.thickness_sd_mm is not None else "# [plate.sd]",
            _line("thickness_mm", known.thickness_sd_mm, 0.02, "standard deviation of the mean thickness"),
            "# mass_g = 0.1",
        ],
        ["[material]", *of_material],
        ["# what to identify, with the bounds of the search", "[unknowns]", *unknown],
        [
            "# a mass on the plate during the test, such as an accelerometer",
            "[[sensor]]" if known.accelerometer is not None else "# [[sensor]]",
            *(
                _line(key, value, example, "")
                for key, value, example in zip(
                    ("mass_g", "x_mm", "y_mm"),
                    known.accelerometer or (None, None, None),
                    (0.6, 300.0, 220.0),
                    strict=True,
                )
            ),
        ],
        [
            "[environment]" if known.air_density_kg_m3 is not None else "# [environment]",
            _line("air_density_kg_m3", known.air_density_kg_m3, ROOM_AIR, "of a room; left out: vacuum"),
        ],
        [
            "[measurement]",
            *measured,
            "# resolution_hz = 0.1         # the step of the list, or the line spacing of the analyser",
            "# relative_std = 0.002        # repeatability, a fraction of each frequency",
            "# complete = false            # modes may be missing from the list",
        ],
    ]
    return "\n\n".join("\n".join(block) for block in blocks) + "\n"


def material_lines(material: TypicalMaterial) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Lines of [material] and of [unknowns] with typical constants."""
    head, unknown = _stated_lines(material, ())
    return (
        *head[:2],
        f"{'known = false':<28} # typical ({material.source}): until this line is removed, only bounds count",
        *(_line(key, value, 0.0, "") for key, value in material.constants.items()),
    ), unknown


def _stated_lines(
    material: TypicalMaterial, constants: Sequence[float]
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Lines of [material] and of [unknowns] with data-sheet constants, commented out where unknown."""
    given: Sequence[float | None] = tuple(constants) or (None,) * len(material.constants)
    return (
        _line("name", material.name, "", "plates of one name share their constants in `diagnose`"),
        _line("symmetry", material.symmetry, "", "isotropic, transversely_isotropic or orthotropic"),
        *(
            _line(key, value, typical, "from the data sheet")
            for (key, typical), value in zip(material.constants.items(), given, strict=True)
        ),
    ), tuple(
        _bounds_line(key, pair, value, material.symmetry)
        for (key, pair), value in zip(material.bounds.items(), given, strict=True)
    )


def _bounds_line(key: str, pair: tuple[float, float], value: float | None, symmetry: str) -> str:
    """Line with the bounds of a constant, widened where they exclude that of the data sheet."""
    lower, upper = pair
    if value is None or lower < value < upper:
        return _line(key, list(pair), [], "")
    largest = _LARGEST_NU if symmetry == "isotropic" and key == "nu12" else math.inf
    wider = [min(lower, (1.0 - _ROOM) * value), max(upper, min((1.0 + _ROOM) * value, largest))]
    return _line(
        key, [float(f"{bound:.3g}") for bound in wider], [], "wider than usual, to hold the data sheet"
    )


def _line(key: str, value: object, example: object, comment: str) -> str:
    """Line with a key and its value, or commented out with an example where there is none."""
    said = f"{key} = {_toml(example if value is None else value)}"
    marked = said if value is not None else f"# {said}"
    return f"{marked:<28} # {comment}".rstrip() if comment else marked


def _toml(value: object) -> str:
    if isinstance(value, list):
        return f"[{', '.join(map(_toml, value))}]"
    return repr(float(value)) if isinstance(value, int | float) else json.dumps(value, ensure_ascii=False)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class NewPlateResult(Result):
    """A plate file that was written.

    missing : what it still lacks, one sentence each
    handling : where to hold and where to hit the plate, None where the file lacks more than frequencies
    """

    command: ClassVar[str] = "new"

    path: Path
    text: str
    missing: tuple[str, ...]
    handling: Handling | None = None


@checked
def new(
    path: str | Path,
    *,
    size_mm: Sequence[float] | None = None,
    mass_g: float | None = None,
    layup: str | None = None,
    edges: str | None = None,
    material: str = "carbon",
    constants: Sequence[float] = (),
    thickness_sd_mm: float | None = None,
    accelerometer: Sequence[float] | None = None,
    air_density_kg_m3: float | None = None,
    frequencies_hz: Sequence[float] = (),
    table: str | None = None,
) -> NewPlateResult:
    """Write a commented plate file; an existing file is never overwritten.

    Parameters
    ----------
    path : the file to write; the plate is named after it
    size_mm : length, width and thickness
    mass_g : of the bare plate
    layup, edges : as in a plate file
    material : a name in `MATERIALS`, which sets the bounds of the search
    constants : from its data sheet: E1, E2, nu12, G12, for a metal E1, nu12, moduli in GPa; if left out, to
        be filled in by hand
    thickness_sd_mm : standard deviation of the mean thickness
    accelerometer : its mass, g, and position x, y, mm; None for a microphone or a laser
    air_density_kg_m3 : of the surrounding air, 1.2 in a room; None for a model in vacuum
    frequencies_hz, table : measured frequencies, or a table of modes instead

    Raises
    ------
    ValueError
        If the file exists or cannot be written, or what is given contradicts itself.

    Examples
    --------
    >>> import cpam_bayes as cb
    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as directory:
    ...     file = cb.new(f"{directory}/panel.toml", size_mm=(310, 228, 3.1), material="metal", edges="FFFF")
    >>> [problem.partition(", ")[0] for problem in file.missing]
    ['plate: density', 'material.E1_GPa: missing', 'material.nu12: missing', 'measurement: frequencies']
    """
    target = require_new(path)
    known = KnownPlate(
        target.stem,
        size_mm,
        mass_g,
        layup,
        edges,
        material,
        constants,
        False,
        thickness_sd_mm,
        accelerometer,
        air_density_kg_m3,
        tuple(frequencies_hz),
        table,
    )
    text, missing = plate_text(target, known)
    try:
        write_whole(target, text.encode())
    except OSError as error:
        raise ValueError(f"{target}: cannot be written to: {error.strerror}") from None
    handling = handling_before(tomllib.loads(text))
    return NewPlateResult(seed=0, path=target, text=text, missing=missing, handling=handling)


def require_new(path: str | Path) -> Path:
    """The path of a new file; raises ``ValueError`` if it exists or cannot be written."""
    target = Path(path)
    if not target.name:
        raise ValueError(f"FILE: received {str(path)!r}, accepted: the file to write")
    if target.exists() or not replaceable(target):
        raise ValueError(f"{target}: exists; give another name")
    return target


def plate_text(target: Path, known: KnownPlate) -> tuple[str, tuple[str, ...]]:
    """Text of a new plate file, and what it lacks, one sentence each; raises as `new` does."""
    require_choice("material", known.material, tuple(MATERIALS))
    names = tuple(MATERIALS[known.material].constants)
    for what, given, accepted in (
        ("size", known.size_mm, ("length", "width", "thickness in mm")),
        ("accelerometer", known.accelerometer, ("mass in g", "x", "y in mm")),
        ("constants", known.constants or None, names),
    ):
        if given is not None and len(given) != len(accepted):
            raise ValueError(f"{what}: received {len(given)} numbers, accepted: {listed(accepted, 'and')}")
    text = plate_file_text(known)
    return text, _missing(text, target)


def _missing(text: str, path: Path) -> tuple[str, ...]:
    """The missing entries; raises ``PlateFileError`` for any other fault of the entries."""
    try:
        parse_specimen(text, path.name, path.parent)
    except PlateFileError as error:
        wrong = [problem for problem in error.problems if problem not in error.gaps]
        if wrong:
            raise PlateFileError(*map(_without_place, wrong)) from None
        return tuple(map(_without_place, error.gaps))
    return ()


def _without_place(problem: str) -> str:
    """A problem without its file, not written yet, and line."""
    return problem.partition(": ")[2]


@present.register
def _present(result: NewPlateResult) -> Report:
    many = len(result.missing)
    lacks = f"{many} entr{'y' if many == 1 else 'ies'} missing" if many else "no entry missing"
    return Report(
        summary=Summary(
            title="new",
            headline=f"{result.path} is written; {lacks}.",
            tables=(remarks("Missing", result.missing),),
            lines=(
                "The bounds of the search are typical of the material.",
                *(() if result.handling is None else (result.handling.sentence,)),
            ),
            next_step="fill in the lines that begin with #, then check the file:  "
            f"cpam-bayes forward {shlex.quote(str(result.path))}",
        ),
        document={
            "command": result.command,
            "version": __version__,
            "path": str(result.path),
            "missing": list(result.missing),
            "handling": None if result.handling is None else result.handling.keys,
        },
    )


# Typed instead of an answer, goes back to the previous question.
_BACK: Final = "<"


@dataclass(frozen=True, slots=True)
class Question:
    """One question at the terminal.

    key : argument of `cpam_bayes.new` that it fills
    read : parser of the typed line; raises ValueError for an invalid one
    """

    key: str
    text: str
    read: Callable[[str], Any]


def _numbers(text: str) -> tuple[float, ...]:
    """Numbers, all with decimal points or all with commas; a lone one with a comma is ambiguous, refused."""
    values = numbers_of(text)
    if values is None:
        raise ValueError(f"received {text!r}, accepted: numbers separated by spaces, such as 310 228 3.1")
    return values


def _number(text: str) -> float:
    value = number_of(text, UNITS["g"])
    if value is None:
        raise ValueError(f"received {text!r}, accepted: one number, such as 340.7")
    return value


def _in_air(text: str) -> float | None:
    """Density of room air for a yes, None for a no."""
    said = text.casefold()
    if said not in ("yes", "y", "no", "n"):
        raise ValueError(f"received {text!r}, accepted: yes or no")
    return ROOM_AIR if said[0] == "y" else None


QUESTIONS: Final = (
    Question("size_mm", "Length (along x), width and thickness in mm, such as 310 228 3.1", _numbers),
    Question("mass_g", "Mass of the bare plate in g", _number),
    Question(
        "material", f"Material, one of {' '.join(MATERIALS)}; left empty: {_FIRST_MATERIAL}", str.casefold
    ),
    Question(
        "constants",
        "E1 E2 nu12 G12 from its data sheet in GPa, for a metal E1 nu12; left empty: add them to the file",
        _numbers,
    ),
    Question("layup", 'Layup in degrees, bottom to top, such as [0/90]_2s or [0_8]; "?" is unknown', str),
    Question(
        "edges", "Edges x=0, y=0, x=length, y=width: F free, S supported, C clamped, such as FFFF", str.upper
    ),
    Question(
        "thickness_sd_mm",
        "Standard deviation of the mean thickness in mm, such as 0.02",
        _number,
    ),
    Question(
        "accelerometer",
        "Accelerometer: its mass in g and place x y in mm, such as 0.6 300 220; left empty: none",
        _numbers,
    ),
    Question("air_density_kg_m3", "Was it tested in air? yes or no", _in_air),
    Question(
        "table", "Table of measured modes, path from the plate file; left empty: enter frequencies next", str
    ),
    Question("frequencies_hz", "Measured frequencies in Hz, ascending, separated by spaces", _numbers),
)


def asked(check: Callable[[dict[str, Any]], object]) -> dict[str, Any]:
    """Arguments of `cpam_bayes.new` from answers at a terminal.

    check : raises ValueError for an impossible answer; the question is then repeated
    """
    print(
        f"What is known about the plate? Leave unknown entries empty; {_BACK} goes back; Ctrl-C quits.",
        file=sys.stderr,
    )
    at, before = 0, [dict[str, Any]()]  # what was known before each of the questions so far
    while at < len(QUESTIONS):
        given = before[at]
        answered = given if _left_out(QUESTIONS[at], given) else _answer(QUESTIONS[at], given, check)
        if answered is None:
            at = max((i for i in range(at) if not _left_out(QUESTIONS[i], before[i])), default=0)
            continue
        at += 1
        before[at:] = [answered]
    return before[-1]


def _left_out(question: Question, given: dict[str, Any]) -> bool:
    """Whether earlier answers make a question unnecessary."""
    of_metal = question.key == "layup" and given.get("material") == "metal"
    return of_metal or (question.key == "frequencies_hz" and "table" in given)


def _answer(
    question: Question, given: dict[str, Any], check: Callable[[dict[str, Any]], object]
) -> dict[str, Any] | None:
    """The known entries with the new answer; None to go back to the previous question."""
    while True:
        print(f"{question.text}: ", end="", file=sys.stderr, flush=True)
        try:
            text = input().strip()
        except EOFError:
            raise ValueError("not all questions were answered; nothing is written") from None
        if not text:
            return given
        if text == _BACK:
            return None
        try:
            told = {**given, question.key: question.read(text)}
            check(told)
        except ValueError as error:
            back = f" ({_BACK} goes back to the last question)" if given else ""
            print(f"  {error}{back}", file=sys.stderr)
        else:
            return told


def _asked_at_a_terminal(path: str, **given: Any) -> dict[str, Any]:
    """Answers at a terminal, if the command line gives nothing about the plate."""
    if given or sys.stdin is None or not sys.stdin.isatty():
        return {}
    target = require_new(path)
    return asked(lambda told: plate_text(target, KnownPlate(target.stem, **told)))


_NUMBER: Final = positive(1e9)
# an option that is not given is not passed on
_given: Final = partial(option, default=argparse.SUPPRESS)
COMMAND: Final = Command(
    new,
    (
        option("file", metavar="FILE", help="the plate file to write; never overwritten"),
        _given(
            "--size",
            "size_mm",
            nargs=3,
            type=_NUMBER,
            metavar=("LENGTH", "WIDTH", "THICKNESS"),
            help="length (along x), width and thickness, mm",
        ),
        _given(
            "--mass",
            "mass_g",
            type=_NUMBER,
            metavar="GRAMS",
            help="mass of the bare plate, g",
        ),
        _given(
            "--layup",
            metavar="LAYUP",
            help='ply angles, bottom to top, such as "[0/90]_2s"',
        ),
        _given(
            "--edges",
            metavar="EDGES",
            help="FFFF: free; F, S or C for x=0, y=0, x=length, y=width",
        ),
        _given(
            "--material",
            choices=tuple(MATERIALS),
            help=f"sets typical bounds of the search (default: {_FIRST_MATERIAL})",
        ),
        _given(
            "--constants",
            nargs="+",
            type=_NUMBER,
            metavar="VALUE",
            help="E1 E2 nu12 G12 from the data sheet, GPa; for a metal E1 nu12",
        ),
        _given(
            "--thickness-sd",
            "thickness_sd_mm",
            type=_NUMBER,
            metavar="MM",
            help="standard deviation of the mean thickness, mm",
        ),
        _given(
            "--accelerometer",
            nargs=3,
            type=float,
            metavar=("GRAMS", "X", "Y"),
            help="a mass on the plate during the test, g, and its place, mm",
        ),
        _given(
            "--air",
            "air_density_kg_m3",
            type=_NUMBER,
            metavar="DENSITY",
            help=f"density of the surrounding air, {ROOM_AIR:g} kg/m3 in a room",
        ),
        _given(
            "--frequencies",
            "frequencies_hz",
            nargs="+",
            type=_NUMBER,
            metavar="HZ",
            help="ascending, Hz",
        ),
        _given(
            "--table",
            metavar="TABLE",
            help="a table of modes instead of --frequencies, path from FILE",
        ),
    ),
    out=None,
    watched=False,
    seeded=False,
    asks=_asked_at_a_terminal,
)
