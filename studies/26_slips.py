"""How often `identify` names a slip of a plate file, and how often it names one where there is none.

python studies/26_slips.py [--quick] [--minutes M] [--development]

Plates are drawn; their lists come from elements that are independent of the package, with 0.2 % of noise. Ten
kinds of slip, 20 plates each: the file is wrong in one place about the plate or the list. Beside them 100
plates without a slip and 100 with a real cause, for which none is to be named. A slip with which the wrong
file still fits within the noise cannot be seen in its list; such files are counted separately.

`--development` draws other plates, prints each file and saves nothing.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

import cpam_bayes as cb
from cpam_bayes.errors import PlateFileError
from cpam_bayes.questions.identify.slips import GROSS
from cpam_bayes.render.report import Heading, Table
from cpam_bayes.render.terminal import screen_text
from validation.independent.true_plate import Mass, Patch, TruePlate, natural_frequencies
from validation.reporting import Results, case_by_case, cases_main, paragraph

Array = NDArray[np.float64]
RESULTS = Path(__file__).parent / "results" / f"{Path(__file__).stem}.json"

KEYS = {
    "quick": "whether this is the small version",
    "counts": "one a slip, for plates without one and for real causes: files by what was named",
    "cases": "one a file: what is wrong, what was named, rms misfit, whether noise explains it, seconds",
}

NOISE = 0.002
# Numbers of plates of each slip, without one, and of each real cause.
PLATES, CLEAN, EACH_CAUSE = 20, 100, 20
# Seeds of the plates that are reported and of those on which the method was developed.
REPORTED, DEVELOPMENT = 27, 2600
# Possible outcomes of a file.
RIGHT, OTHER, NONE, UNSEEN, REFUSED = OUTCOMES = (
    "right",
    "another slip",
    "none",
    "cannot be seen",
    "refused with a message",
)

CONSTANTS: dict[str, dict[str, float]] = {
    "carbon": {"E1": 128e9, "E2": 9.0e9, "nu12": 0.3, "G12": 4.9e9},
    "glass": {"E1": 40e9, "E2": 10.5e9, "nu12": 0.27, "G12": 4.2e9},
    "aluminium": {"E1": 70e9, "nu12": 0.33},
}
DENSITY = {"carbon": 1560.0, "glass": 1920.0, "aluminium": 2700.0}
BOUNDS: dict[str, dict[str, list[float]]] = {
    "carbon": {"E1": [60.0, 220.0], "E2": [4.0, 20.0], "nu12": [0.1, 0.5], "G12": [2.0, 12.0]},
    "glass": {"E1": [15.0, 80.0], "E2": [4.0, 30.0], "nu12": [0.1, 0.45], "G12": [1.5, 12.0]},
    "aluminium": {"E1": [20.0, 200.0], "nu12": [0.1, 0.45]},
}
HALVES = ((0.0,) * 4, (0.0, 90.0) * 2, (0.0, 0.0, 90.0, 0.0), (90.0, 0.0, 0.0, 0.0), (0.0, 45.0, -45.0, 90.0))
EDGES = ("FFFF", "CFFF", "CFCF", "FFFF", "SSSS", "CSFF")


class Stated(NamedTuple):
    """The true plate, and its file.

    truth : the error as `Slip` names it, with the number of the mode or frequency, 0 for the plate
    """

    true: TruePlate
    file: dict[str, Any]
    truth: tuple[str, int] = ("", 0)


def drawn(rng: np.random.Generator, edges: tuple[str, ...] = EDGES, plies: bool = False) -> TruePlate:
    """A random plate; edges : to choose from; plies : only of an orthotropic material."""
    kind = str(
        rng.choice(["carbon", "carbon", "glass"] if plies else ["carbon", "carbon", "glass", "aluminium"])
    )
    half = HALVES[int(rng.integers(len(HALVES)))] if kind != "aluminium" else (0.0,)
    length = rng.uniform(0.18, 0.4)
    constants = {n: v * float(np.exp(0.05 * rng.standard_normal())) for n, v in CONSTANTS[kind].items()}
    return TruePlate(
        length=round(length, 4),
        width=round(length * rng.uniform(0.55, 0.92), 4),
        thickness=round(rng.uniform(1.2, 4.0) * 1e-3, 5),
        density=DENSITY[kind],
        edges=str(rng.choice(edges)),
        angles_deg=(*half, *half[::-1]),
        constants=constants,
    )


def file_of(plate: TruePlate, f: Array, rng: np.random.Generator) -> dict[str, Any]:
    """Plate file of a list (n,) Hz; half of the files state the repeatability, half [material.sd]."""
    kind = min(DENSITY, key=lambda k: abs(DENSITY[k] - plate.density))
    shown = {n: f"{n}_GPa" if n != "nu12" else n for n in CONSTANTS[kind]}
    unit = {n: 1e9 if n != "nu12" else 1.0 for n in shown}
    material: dict[str, Any] = {shown[n]: v / unit[n] for n, v in CONSTANTS[kind].items()}
    if rng.random() < 0.5:
        material["sd"] = {key: 0.1 * value for key, value in material.items()}
    measurement: dict[str, Any] = {"frequencies_hz": _rounded(np.sort(f))}
    if rng.random() < 0.5:
        measurement["relative_std"] = NOISE
    return {
        "name": "plate",
        "plate": {
            "length_mm": 1e3 * plate.length,
            "width_mm": 1e3 * plate.width,
            "thickness_mm": 1e3 * plate.thickness,
            "density_kg_m3": plate.density,
            "layup": f"[{'/'.join(f'{a:g}' for a in plate.angles_deg)}]",
            "edges": plate.edges,
        },
        "material": material | ({"isotropic": True} if kind == "aluminium" else {}),
        "unknowns": {shown[n]: pair for n, pair in BOUNDS[kind].items()},
        "measurement": measurement,
    }


def _rounded(f: Array) -> list[float]:
    return [float(f"{value:.5g}") for value in f]


def measured(plate: TruePlate, n: int, rng: np.random.Generator) -> Array:
    return natural_frequencies(plate, n) * (1.0 + NOISE * rng.standard_normal(n))


def _restated(
    change: Callable[[dict[str, Any]], None], kind: str, **how: Any
) -> Callable[[np.random.Generator], Stated]:
    """Maker of files with a slip in the table [plate]."""

    def made(rng: np.random.Generator) -> Stated:
        plate = drawn(rng, **how)
        file = file_of(plate, measured(plate, int(rng.integers(8, 14)), rng), rng)
        change(file["plate"])
        return Stated(plate, file, (kind, 0))

    return made


def _exchanged(plate: dict[str, Any]) -> None:
    plate["length_mm"], plate["width_mm"] = plate["width_mm"], plate["length_mm"]


def _turned(plate: dict[str, Any]) -> None:
    angles = [float(a) for a in plate["layup"].strip("[]").split("/")]
    plate["layup"] = f"[{'/'.join(f'{a + 90.0 if a <= 0.0 else a - 90.0:g}' for a in angles)}]"


def _neighbouring(plate: dict[str, Any]) -> None:
    plate["edges"] = plate["edges"][1:] + plate["edges"][0]


def _held_otherwise(plate: dict[str, Any]) -> None:
    plate["edges"] = plate["edges"].translate(str.maketrans("CS", "SC"))


def _set_free(plate: dict[str, Any]) -> None:
    plate["edges"] = "FFFF"


def _set_clamped(plate: dict[str, Any]) -> None:
    plate["edges"] = "CFFF"


def _relisted(
    change: Callable[[Array, np.random.Generator], tuple[Array, int]], kind: str
) -> Callable[[np.random.Generator], Stated]:
    """Maker of files with a slip in the list."""

    def made(rng: np.random.Generator) -> Stated:
        plate = drawn(rng)
        f, number = change(np.sort(measured(plate, int(rng.integers(9, 15)), rng)), rng)
        return Stated(plate, file_of(plate, f, rng), (kind, number))

    return made


def _missed(f: Array, rng: np.random.Generator) -> tuple[Array, int]:
    k = int(rng.integers(len(f) - 2))
    return np.delete(f, k), k + 1


def _false(f: Array, rng: np.random.Generator) -> tuple[Array, int]:
    value = rng.uniform(0.8 * f[0], f[-2])
    return np.sort(np.append(f, value)), int(np.searchsorted(f, value)) + 1


def _misread(f: Array, rng: np.random.Generator) -> tuple[Array, int]:
    """Exchange two different digits among the first three of a frequency."""
    while True:
        i = int(rng.integers(len(f)))
        digits = f"{f[i]:.5e}".replace(".", "")
        a = int(rng.integers(2))
        text = digits[:a] + digits[a + 1] + digits[a] + digits[a + 2 :]
        value = float(f"{text[0]}.{text[1:]}")
        others = np.delete(f, i)
        if text[0] != "0" and abs(value / f[i] - 1.0) > 0.02:
            return np.sort(np.append(others, value)), int(np.searchsorted(others, value)) + 1


def _decimal(f: Array, rng: np.random.Generator) -> tuple[Array, int]:
    i = int(rng.integers(len(f)))
    value = f[i] * float(rng.choice([0.1, 10.0]))
    others = np.delete(f, i)
    return np.sort(np.append(others, value)), int(np.searchsorted(others, value)) + 1


CLAMPED = ("CFFF", "CFCF", "CSFF")
SLIPS: dict[str, Callable[[np.random.Generator], Stated]] = {
    "sides": _restated(_exchanged, "sides", plies=True),
    "layup": _restated(_turned, "layup", plies=True),
    "edges": _restated(_neighbouring, "edges", edges=("CFFF", "CSFF", "CFCF")),
    "supports": _restated(_held_otherwise, "supports", edges=("CFFF", "CFCF", "SSSS")),
    "missed": _relisted(_missed, "missed"),
    "false": _relisted(_false, "false"),
    "misread": _relisted(_misread, "misread"),
    "decimal": _relisted(_decimal, "decimal"),
    "clamped": _restated(_set_free, "clamped", edges=("CFFF", "FCFF")),
    "free": _restated(_set_clamped, "free", edges=("FFFF",)),
}


def _mass(p: TruePlate, rng: np.random.Generator) -> TruePlate:
    x, y = rng.uniform(0.1, 0.9, 2) * (p.length, p.width)
    return replace(p, masses=(Mass(rng.uniform(0.02, 0.15) * p.total_mass, x, y),))


def _hole(p: TruePlate, rng: np.random.Generator) -> TruePlate:
    x, y = rng.uniform(0.25, 0.75, 2) * (p.length, p.width)
    half = rng.uniform(0.05, 0.12) * p.width
    return replace(p, patches=(Patch("ellipse", x, y, half, half, rng.uniform(0.4, 0.95)),))


# Kinds that were added after the others had been counted.
LATER = ("clamped", "free")


CAUSES: dict[str, tuple[Callable[[TruePlate, np.random.Generator], TruePlate], tuple[str, ...]]] = {
    "taper": (lambda p, rng: replace(p, taper=(rng.uniform(0.04, 0.2), 0.0)), EDGES),
    "sensor_mass": (_mass, EDGES),
    "clamp_rotation": (lambda p, rng: replace(p, turn=float(np.exp(rng.uniform(-4.0, -0.7)))), CLAMPED),
    "skew": (lambda p, rng: replace(p, skew_deg=rng.uniform(2.0, 8.0)), EDGES),
    "damage": (_hole, EDGES),
}


def _with_cause(name: str) -> Callable[[np.random.Generator], Stated]:
    cause, edges = CAUSES[name]

    def made(rng: np.random.Generator) -> Stated:
        plate = cause(drawn(rng, edges), rng)
        return Stated(plate, file_of(plate, measured(plate, int(rng.integers(8, 14)), rng), rng))

    return made


def _clean(rng: np.random.Generator) -> Stated:
    plate = drawn(rng)
    return Stated(plate, file_of(plate, measured(plate, int(rng.integers(8, 14)), rng), rng))


KINDS: Mapping[str, Callable[[np.random.Generator], Stated]] = {
    **SLIPS,
    "clean": _clean,
    **{name: _with_cause(name) for name in CAUSES},
}


def plan() -> tuple[str, ...]:
    """Kind of each file; the kinds take turns, the later ones at the end so that numbers stay."""
    each = dict.fromkeys(SLIPS, PLATES) | {"clean": CLEAN} | dict.fromkeys(CAUSES, EACH_CAUSE)
    order = [(name in LATER, (i + 0.5) / n, name) for name, n in each.items() for i in range(n)]
    return tuple(name for *_, name in sorted(order))


def case(number: int, seed: int = REPORTED) -> Results:
    """One file and the answer of `identify`."""
    name, start = plan()[number], time.perf_counter()
    stated = KINDS[name](np.random.default_rng([seed, number]))
    found = {
        "case": number,
        "kind": name,
        "truth": list(stated.truth),
        "edges": stated.file["plate"]["edges"],
    }
    try:
        answer = cb.identify(stated.file, seed=0, residuals="relative")
    except PlateFileError as error:
        seconds = round(time.perf_counter() - start, 1)
        return {**found, "refused": str(error), "named": [], "within_noise": False, "seconds": seconds}
    estimate = answer.estimate
    known = "relative_std" in stated.file["measurement"]
    return {
        **found,
        "named": [[slip.kind, slip.number] for slip in answer.explained_by],
        "rms": estimate.rms,
        "within_noise": estimate.misfit == 1.0 if known else estimate.noise <= 2.5 * NOISE,
        "below_gross": estimate.rms <= GROSS,
        "seconds": round(time.perf_counter() - start, 1),
    }


def said(found: Results) -> str:
    """Outcome of a file."""
    if "refused" in found:
        return REFUSED
    if found["named"]:
        named, truth = [tuple(slip) for slip in found["named"]], tuple(found["truth"])
        # a plate with four equal edges has one spectrum for both, and they share one name
        if truth == ("layup", 0) and len(set(found["edges"])) == 1:
            truth = ("sides", 0)
        return RIGHT if truth in named else OTHER
    if found["truth"][0] and found["within_noise"]:
        return UNSEEN
    return NONE


def results_of(cases: list[Results], quick: bool) -> Results:
    counts = []
    for name in (*SLIPS, "clean", *CAUSES):
        those = [said(c) for c in cases if c["kind"] == name]
        if those:
            counts.append({"kind": name} | {what: those.count(what) for what in OUTCOMES})
    return {"quick": quick, "counts": counts, "cases": cases}


def run(quick: bool, minutes: float = float("inf")) -> Results:
    """Results of all files, those not yet saved being computed; quick: two files."""
    if quick:
        return results_of([case(plan().index(name)) for name in ("decimal", "clean")], quick)
    return case_by_case(
        range(len(plan())), case, lambda c: results_of(c, False), minutes=minutes, path=RESULTS
    )


def sections(results: Results) -> dict[str, str]:
    """Paragraph of a page on how often a slip is named."""
    counts = {row["kind"]: row for row in results["counts"]}
    slips = [kind for kind in SLIPS if kind in counts]
    right, other, none, unseen, refused = (sum(counts[k][what] for k in slips) for what in OUTCOMES)
    free = [kind for kind in counts if kind not in SLIPS]
    files, wrong = (
        sum(counts[k][what] for k in free for what in outcomes) for outcomes in (OUTCOMES, (OTHER,))
    )
    said = (
        f"Of {right + other + none + unseen + refused} simulated files with one of {len(slips)} slips each, "
        f"{right} had it named, {other} another one and {none + refused} none; {unseen} fitted to within the "
        f"noise. Of {files} files without a slip, half of them with a real cause such as a taper, "
        f"{wrong} had one named."
    )
    return {"named": paragraph(said)}


def show(results: Results) -> None:
    rows = tuple((c["kind"], *(str(c[what]) for what in OUTCOMES)) for c in results["counts"])
    columns = (Heading("kind"), *(Heading(what, number=True) for what in OUTCOMES))
    print(screen_text((Table("Files by what was named", columns, rows),), sys.stdout))


def main() -> None:
    others = partial(
        case_by_case,
        range(len(plan())),
        partial(case, seed=DEVELOPMENT),
        partial(results_of, quick=True),
        say=lambda c: print(said(c), c, flush=True),
    )
    cases_main(__doc__, run, show, RESULTS, others)


if __name__ == "__main__":
    main()
