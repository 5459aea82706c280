"""Is the coin test right? Coins on plates of independent elements and of bricks, and repeats without one.

python studies/27_coins.py [--quick] [--minutes M] [--development]

Forty plates of elements that are independent of the package, each with one to five further lists with a coin
and one without. Frequencies carry noise of 0.05 to 0.5 %, which half of the files state; thickness, mass and
constants differ slightly from the stated ones. A coin is a disc of 0.5 to 8 % of the plate's mass, 2 mm of
steel thick: its mass is spread over a footprint and has a rotary inertia. Ten more plates, with one to three
coins, are three-dimensional bricks computed by CalculiX; they are left out if its program `ccx` is missing.

`--development` draws other plates, prints each and saves nothing.
"""

from __future__ import annotations

import shutil
import sys
import tempfile
import time
from dataclasses import replace
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import cpam_bayes as cb
from cpam_bayes.identification.added_mass import Finding
from cpam_bayes.plate import read_plate
from cpam_bayes.plate.laminate import complete_constants
from cpam_bayes.render.report import Heading, Table
from cpam_bayes.render.terminal import screen_text
from validation import bricks
from validation.independent.true_plate import Mass, TruePlate, natural_frequencies
from validation.laboratory import REFERENCES, material_tables
from validation.reporting import Results, case_by_case, cases_main, markdown_table, paragraph

Array = NDArray[np.float64]
RESULTS = Path(__file__).parent / "results" / f"{Path(__file__).stem}.json"

KEYS = {
    "quick": "whether this is the small version",
    "counts": "by solver, of coins above the detection limit, below it and repeats: how many, what was said",
    "cases": "one a plate: solver, edges, noise, seconds; its lists: g sealed, found, interval, mm off",
}

PLATES, MOST_COINS = 40, 5
# First number of the brick plates.
BRICKS, BRICK_PLATES, MOST_ON_BRICKS = 100, 10, 3
# Elements in the plane; lines through the points of all coins are added to the mesh of every list.
IN_PLANE, NOTHING = 160, 1e-12
# Seeds of the plates that are reported and of those inspected before.
REPORTED, DEVELOPMENT = 31, 2700
NOISES = (5e-4, 5e-3)
# Range of a coin's mass over the plate's.
MASSES = (0.005, 0.08)
# Relative standard deviations of a laboratory's weighed mass, gauged thickness and assumed constants.
WEIGHED, GAUGED, BELIEVED = 1e-3, 5e-3, 0.05
# Mass of a coin over its area, kg/m2. Offsets of its point masses along each axis, over the radius, and their
# shares of the mass: with the second moment of a disc.
AREAL = 16.0
POINTS = ((-0.75, 2.0 / 9.0), (0.0, 5.0 / 9.0), (0.75, 2.0 / 9.0))
NEAR_MM = 10.0
GROUPS = ("above the limit", "below the limit", "repeats")
SOLVERS = ("elements", "bricks")

LAYUPS = ("[0/90/0/90]_s", "[0/45/-45/90]_s", "[0_8]", "[90/0/0/0]_s")
EDGES = ("FFFF", "FFFF", "FFFF", "CFFF", "CFCF", "SSSS")


def stated_plate(rng: np.random.Generator, edges: tuple[str, ...] = EDGES) -> dict[str, Any]:
    """A plate file without a list."""
    reference, density = REFERENCES[str(rng.choice(["carbon", "glass"]))]
    length = rng.uniform(180.0, 360.0)
    sizes = (round(length, 1), round(length * rng.uniform(0.55, 0.9), 1), round(rng.uniform(1.5, 4.0), 2))
    return {
        "name": "plate",
        "plate": {
            **dict(zip(("length_mm", "width_mm", "thickness_mm"), sizes, strict=True)),
            "mass_g": round(1e-6 * density * float(np.prod(sizes)), 2),
            "layup": str(rng.choice(LAYUPS)),
            "edges": str(rng.choice(edges)),
        },
        **material_tables(reference),
    }


def true_plate(stated: dict[str, Any], rng: np.random.Generator) -> TruePlate:
    """The true plate."""
    plate, material = stated["plate"], read_plate(stated).material.constants
    sizes = {key: 1e-3 * plate[f"{key}_mm"] for key in ("length", "width", "thickness")}
    sizes["thickness"] *= float(np.exp(GAUGED * rng.standard_normal()))
    mass = 1e-3 * plate["mass_g"] * float(np.exp(WEIGHED * rng.standard_normal()))
    return TruePlate(
        **sizes,
        density=mass / float(np.prod(list(sizes.values()))),
        edges=plate["edges"],
        angles_deg=tuple(read_plate(stated).plate.layup.angles_deg.tolist()),
        constants={n: v * float(np.exp(BELIEVED * rng.standard_normal())) for n, v in material.items()},
    )


def coin(mass: float, x: float, y: float, sides: Array) -> tuple[Mass, ...]:
    """Point masses, kg, of a disc about a place, m, moved so that they lie on the plate."""
    radius = float(np.sqrt(mass / (np.pi * AREAL)))
    reach = 0.75 * radius
    x, y = np.clip((x, y), reach, sides - reach)
    return tuple(
        Mass(mass * of_x * of_y, float(x + at_x * radius), float(y + at_y * radius))
        for at_x, of_x in POINTS
        for at_y, of_y in POINTS
    )


def of_elements(true: TruePlate, coins: list[tuple[Mass, ...]], n_modes: int) -> list[Array]:
    """Frequencies without a coin, and with each, Hz."""
    return [natural_frequencies(replace(true, masses=on), n_modes) for on in ((), *coins)]


def of_bricks(true: TruePlate, coins: list[tuple[Mass, ...]], n_modes: int) -> list[Array]:
    """Frequencies of bricks without a coin, and with each, Hz; on one mesh, so that they share its error."""
    plate = {f"{key}_mm": 1e3 * getattr(true, key) for key in ("length", "width", "thickness")}
    layup = f"[{'/'.join(f'{a:g}' for a in true.angles_deg)}]"
    plate |= {"density_kg_m3": true.density, "layup": layup, "edges": true.edges}
    material = material_tables(true.constants)["material"]
    specimen = read_plate({"name": "bricks", "plate": plate, "material": material})
    whole = complete_constants(dict(true.constants), "transversely_isotropic")
    constants = {name: float(value) for name, value in whole.items()}
    every = [replace(mass, mass=NOTHING) for on in coins for mass in on]
    found = []
    for on in ((), *coins):
        held = {(m.x, m.y): m.mass for m in (*every, *on)}
        flaws = bricks.Flaws(masses=tuple(bricks.Mass(m, x, y) for (x, y), m in held.items()))
        found.append(bricks.flawed_frequencies(specimen, constants, n_modes, flaws, in_plane=IN_PLANE))
    return found


def case(number: int, seed: int = REPORTED) -> Results:
    """One plate, its lists, and the findings of `prove`."""
    start, rng = time.perf_counter(), np.random.default_rng([seed, number])
    on_bricks = number >= BRICKS
    stated = stated_plate(rng, tuple(e for e in EDGES if "S" not in e) if on_bricks else EDGES)
    true = true_plate(stated, rng)
    n_modes = int(rng.integers(8, 15))
    n_coins = int(rng.integers(1, (MOST_ON_BRICKS if on_bricks else MOST_COINS) + 1))
    noise = float(np.exp(rng.uniform(*np.log(NOISES))))
    sides = np.array([true.length, true.width])
    # off clamps, where a coin has no effect, and well separated
    cells = np.stack([rng.permutation(n_coins) for _ in sides], axis=1)
    places = (cells + rng.uniform(0.2, 0.8, (n_coins, 2))) / n_coins * sides
    masses = true.total_mass * np.exp(rng.uniform(*np.log(MASSES), n_coins))
    coins = [coin(m, x, y, sides) for m, (x, y) in zip(masses, places, strict=True)]
    lists = (of_bricks if on_bricks else of_elements)(true, coins, n_modes)
    lists.append(lists[0])
    measured = [_rounded(f * (1.0 + noise * rng.standard_normal(n_modes))) for f in lists]
    measurement: dict[str, Any] = {"frequencies_hz": measured[0]}
    known = bool(rng.random() < 0.5)
    if known:
        measurement["relative_std"] = float(f"{noise:.2g}")
    # the middle of the nine points, row by row
    sealed = [(1e3 * m, 1e3 * on[4].x, 1e3 * on[4].y) for m, on in zip(masses.tolist(), coins, strict=True)]
    with tempfile.TemporaryDirectory() as folder:
        seal = Path(folder) / "seal.toml"
        tables = [f"[[coin]]\nmass_g = {m}\nx_mm = {x}\ny_mm = {y}\n" for m, x, y in sealed]
        seal.write_text("\n".join([*tables, "[[coin]]\nmass_g = 0\n"]), encoding="utf-8")
        answer = cb.prove({**stated, "measurement": measurement}, *measured[1:], sealed=seal, seed=0)
    limit = None if answer.detection_limit is None else 1e3 * answer.detection_limit
    found = []
    for (mass, _, _), said in zip([*sealed, (0.0, 0.0, 0.0)], answer.coins, strict=True):
        low, high = (1e3 * value for value in said.found.interval)
        found.append(
            {
                "case": number,
                "sealed_g": mass,
                "found_g": 1e3 * said.found.mass,
                "low_g": low,
                "high_g": high,
                "limit_g": limit,
                "finding": said.found.finding.value,
                "distance_mm": None if said.distance is None else 1e3 * said.distance,
                "radius_mm": 1e3 * said.found.radius,
                "shifts_inside": said.shifts_inside,
                "modes": n_modes,
            }
        )
    return {
        "case": number,
        "solver": SOLVERS[on_bricks],
        "edges": true.edges,
        "noise": noise,
        "known": known,
        "lists": found,
        "seconds": round(time.perf_counter() - start, 1),
    }


def _rounded(f: Array) -> list[float]:
    return [float(f"{value:.5g}") for value in np.sort(f)]


def group(coin: Results) -> str:
    """Group of a list: with a coin above or below the detection limit, or a repeat."""
    if not coin["sealed_g"]:
        return GROUPS[2]
    seen = coin["limit_g"] is not None and coin["sealed_g"] >= coin["limit_g"]
    return GROUPS[0] if seen else GROUPS[1]


def results_of(cases: list[Results], quick: bool) -> Results:
    counts = []
    for solver, name in product(SOLVERS, GROUPS):
        those = [c for one in cases if one["solver"] == solver for c in one["lists"] if group(c) == name]
        added = [c for c in those if c["finding"] == Finding.ADDED.value and c["sealed_g"]]
        small = [c for c in added if c["radius_mm"] <= NEAR_MM]
        counts.append(
            {
                "solver": solver,
                "group": name,
                "lists": len(those),
                **{f.value: sum(c["finding"] == f.value for c in those) for f in Finding},
                "mass_inside": sum(c["low_g"] <= c["sealed_g"] <= c["high_g"] for c in those),
                "near": sum(c["distance_mm"] <= NEAR_MM for c in added),
                "small": len(small),
                "near_of_small": sum(c["distance_mm"] <= NEAR_MM for c in small),
                "place_inside": sum(c["distance_mm"] <= c["radius_mm"] for c in added),
                "shifts_inside": sum(c["shifts_inside"] for c in those),
                "shifts": sum(c["modes"] for c in those),
            }
        )
    return {"quick": quick, "counts": counts, "cases": cases}


def run(quick: bool, minutes: float = float("inf")) -> Results:
    """Results of all plates, those not yet saved being computed; quick: one plate."""
    if quick:
        return results_of([case(0, DEVELOPMENT)], quick)
    return case_by_case(numbers(), case, lambda c: results_of(c, False), minutes=minutes, path=RESULTS)


def numbers() -> list[int]:
    """Numbers of the plates, the brick plates last."""
    on_bricks = range(BRICKS, BRICKS + BRICK_PLATES) if shutil.which("ccx") else ()
    return [*range(PLATES), *on_bricks]


HEAD = (
    "lists",
    "",
    "claimed",
    "undecided",
    "nothing",
    "otherwise",
    "mass inside",
    "place inside",
    "within 10 mm",
    "within 10 mm, small regions",
)
SAID = (Finding.ADDED, Finding.OPEN, Finding.NOTHING, Finding.OTHER)


def _rows(results: Results) -> list[tuple[str, ...]]:
    rows = []
    for c in results["counts"]:
        if not c["lists"]:
            continue
        inside = ("", "", "", "")
        if c["group"] != GROUPS[2]:
            claimed = c[Finding.ADDED.value]
            inside = (
                f"{c['mass_inside']} of {c['lists']}",
                f"{c['place_inside']} of {claimed}",
                f"{c['near']} of {claimed}",
                f"{c['near_of_small']} of {c['small']}",
            )
        rows.append(
            (f"{c['solver']}, {c['group']}", str(c["lists"]), *(str(c[f.value]) for f in SAID), *inside)
        )
    return rows


def sections(results: Results) -> dict[str, str]:
    """The counts as a table of a page."""
    inside, shifts = (sum(c[key] for c in results["counts"]) for key in ("shifts_inside", "shifts"))
    plates = {solver: sum(c["solver"] == solver for c in results["cases"]) for solver in SOLVERS}
    said = (
        f"Coins of 0.5 to 8 % of the plate's mass were put on {plates['elements']} plates of independent "
        f"finite elements and {plates['bricks']} of three-dimensional bricks, with noise of 0.05 to "
        "0.5 % and with thickness, mass and constants slightly off the stated ones. "
        f"{inside / max(shifts, 1):.3f} of {shifts} shifts lay in the 95 % intervals predicted from the "
        "first list. Places count up to mirror images: inside the stated region; within "
        f"{NEAR_MM:g} mm; the same where the region is that small."
    )
    return {"counts": f"{paragraph(said)}\n\n{markdown_table(HEAD, _rows(results))}"}


def show(results: Results) -> None:
    columns = (Heading(HEAD[0]), *(Heading(text, number=True) for text in HEAD[1:]))
    print(screen_text((Table("Coins by what was said", columns, tuple(_rows(results))),), sys.stdout))


def main() -> None:
    others = partial(
        case_by_case,
        numbers(),
        partial(case, seed=DEVELOPMENT),
        partial(results_of, quick=True),
    )
    cases_main(__doc__, run, show, RESULTS, others)


if __name__ == "__main__":
    main()
