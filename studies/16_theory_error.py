"""How far first-order theory with ideal supports is from three dimensions, mode by mode.

python studies/16_theory_error.py [--quick] [--only [CASE ...]]

Plates of 240 x 180 mm are solved twice with the same constants: by the Ritz model and by CalculiX on
20-node bricks (C3D20R, a layer or more for each run of equal plies). A clamped edge of the bricks is a face
fixed over the whole thickness. Bricks are solved on two meshes, the finer with twice as many elements in the
plane; their frequencies are extrapolated as f_fine - (f_coarse - f_fine) / 3, which is right if the error
falls with the fourth power of the element's side and too little if it falls faster. A third of the difference
is stated as their error.

The bias of the theory and its remaining error are fitted to all bending modes by maximum likelihood, the
factor of the bias known to a half, beside the error of the bricks; fitted to every second plate, they are
judged on the others.

Cases that are saved are not run again unless they are named with --only, which alone runs none: the rule
and the page are then written anew.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import scipy.optimize
from numpy.typing import NDArray

import cpam_bayes as cb
from cpam_bayes.forward_model.calculix.run import solve_modes
from cpam_bayes.forward_model.model import reference_constants
from cpam_bayes.forward_model.three_dimensions import (
    common_theory_errors,
    edge_sums,
    shear_frequency,
    theory_bias,
    theory_error,
    theory_powers,
)
from cpam_bayes.plate import Specimen
from validation.reporting import (
    paragraph,
    save_results,
    saved_results,
    with_saved,
    write_sections,
)

Results = dict[str, Any]
Array = NDArray[Any]

RESULTS = Path(__file__).parent / "results" / f"{Path(__file__).stem}.json"

KEYS = {
    "quick": "whether this is the small version",
    "cases": "one plate: Ritz model and extrapolated bricks, mode by mode, with the error of each",
    "fit": "coefficients of the bias and the scatter, and chi-squared over the modes of plates not fitted",
}

N_MODES = 10
MATERIALS: dict[str, dict[str, Any]] = {
    "carbon": {"E1_GPa": 130.0, "E2_GPa": 9.0, "nu12": 0.3, "G12_GPa": 5.0},
    "glass": {"E1_GPa": 40.0, "E2_GPa": 10.0, "nu12": 0.27, "G12_GPa": 4.0},
    "high modulus": {"E1_GPa": 220.0, "E2_GPa": 7.0, "nu12": 0.3, "G12_GPa": 4.5},
    "isotropic": {"isotropic": True, "E1_GPa": 70.0, "nu12": 0.33},
}
DENSITY = {"carbon": 1580.0, "glass": 1950.0, "high modulus": 1620.0, "isotropic": 2700.0}
LAYUPS = {
    "cross-ply": "[0/90]_2s",
    "unidirectional": "[0]",
    "quasi-isotropic": "[0/45/-45/90]_s",
    "angle-ply": "[45/-45]_2s",
    "angle-ply of few plies": "[45/-45]_s",
    "quasi-isotropic of many plies": "[0/45/-45/90]_3s",
}
ORDINARY = ("cross-ply", "unidirectional", "quasi-isotropic")
LENGTH_MM, WIDTH_MM = 240.0, 180.0
# Short side over thickness.
SLENDERNESS = (150, 50, 25, 15)
# Largest rms error of a plate's bricks, over its modes, for which the largest differences are reported.
EXACT_BRICKS_PERCENT = 0.2


class Case(NamedTuple):
    """A plate of the study; slenderness : short side over thickness."""

    material: str
    layup: str
    edges: str
    slenderness: int

    @property
    def name(self) -> str:
        """Name of the case in the results."""
        return f"{self.material}, {self.layup}, {self.edges}, h/b = 1/{self.slenderness}"


def cases() -> dict[str, Case | str]:
    """All cases by name; built-in specimens are represented by their names."""
    plates = [Case("carbon", k, e, s) for k in ORDINARY for e in ("FFFF", "CFFF") for s in SLENDERNESS]
    plates += [Case("glass", k, e, s) for k in ORDINARY for e in ("FFFF", "CFFF") for s in SLENDERNESS]
    plates += [Case("high modulus", "cross-ply", e, s) for e in ("FFFF", "CFFF") for s in SLENDERNESS]
    plates += [Case("isotropic", "unidirectional", e, s) for e in ("FFFF", "CFFF") for s in SLENDERNESS]
    plates += [Case("carbon", "cross-ply", "CCCC", s) for s in SLENDERNESS]
    plates += [Case("carbon", "angle-ply", e, s) for e in ("FFFF", "CFFF") for s in SLENDERNESS]
    plates += [Case("carbon", k, "FFFF", s) for k in tuple(LAYUPS)[4:] for s in SLENDERNESS[1:3]]
    return {case.name: case for case in plates} | {name: name for name in ("C1", "A2", "D1", "D2", "D3")}


def specimen_of(case: Case | str) -> Specimen:
    """The plate of a case."""
    if isinstance(case, str):
        return cb.read_plate(case)
    return cb.read_plate(
        {
            "name": case.name,
            "plate": {
                "length_mm": LENGTH_MM,
                "width_mm": WIDTH_MM,
                "thickness_mm": WIDTH_MM / case.slenderness,
                "density_kg_m3": DENSITY[case.material],
                "layup": LAYUPS[case.layup],
                "edges": case.edges,
            },
            "material": {"isotropic": False, **MATERIALS[case.material]},
        }
    )


def measured(name: str, case: Case | str, in_plane: int, n_modes: int) -> Results:
    """Results row of one plate.

    in_plane : elements in the plane of the finer mesh.
    """
    specimen = specimen_of(case)
    constants = reference_constants(specimen)
    ritz = cb.forward(specimen, n_modes)
    # two extra modes: where two lie close the other solver may have them in another order
    coarse, fine = (
        solve_modes(specimen, constants, n_modes + 2, in_plane=n) for n in (in_plane // 2, in_plane)
    )
    bricks = fine.frequencies - (coarse.frequencies - fine.frequencies) / 3.0
    brick_error = np.abs(coarse.frequencies - fine.frequencies) / 3.0 / bricks
    rows = []
    for kind in ("bending", "in-plane", "coupled"):
        own = [m for m in ritz.modes if m.kind == kind]
        other = [k for k, m in enumerate(fine.modes) if m.kind == kind]
        for mode, k in zip(own, other, strict=False):
            rows.append(
                {
                    "ritz_hz": mode.frequency,
                    "bricks_hz": float(bricks[k]),
                    "difference_percent": 100.0 * (mode.frequency / float(bricks[k]) - 1.0),
                    "bricks_error_percent": 100.0 * float(brick_error[k]),
                    "kind": kind,
                    "label": mode.label,
                }
            )
    rows.sort(key=lambda row: row["ritz_hz"])
    f = np.array([row["ritz_hz"] for row in rows])
    for row, shear, bias, sd in zip(rows, shear_frequency(specimen, f), *rule(specimen, f), strict=True):
        row |= {"shear_frequency": float(shear), "bias_percent": bias, "rule_percent": sd}
    plate = specimen.plate
    return {
        "case": name,
        "edges": plate.edges,
        "layup": plate.layup.text,
        "h_over_short_side": plate.thickness / min(plate.length, plate.width),
        "E1_over_G13": constants["E1"] / constants["G13"],
        "in_plane": in_plane,
        "ritz_error_percent": 100.0 * float(ritz.error.max()),
        "modes": rows,
    }


def run(
    quick: bool, only: Iterable[str] | None = None, done: Callable[[Results], None] = lambda row: None
) -> Results:
    """Results for the named cases, or all.

    done : called with every row as soon as it is there.
    """
    every = cases()
    names = [next(iter(every))] if quick else list(only if only is not None else every)
    rows = []
    for name in names:
        specimen = specimen_of(every[name])
        n_runs = len(np.flatnonzero(np.diff(specimen.plate.layup.angles_deg))) + 1
        in_plane = 36 if quick else 128 if n_runs > 16 else 200
        n_modes = 4 if quick else min(N_MODES, specimen.measurement.size if specimen.measurement else N_MODES)
        rows.append(measured(name, every[name], in_plane, n_modes))
        done(rows[-1])
    return {"quick": quick, "cases": rows, "fit": fitted(rows)}


def main(arguments: list[str] | None = None) -> int:
    """Run the cases that are not saved, and save after each."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--only", nargs="*", metavar="CASE", choices=tuple(cases()))
    options = parser.parse_args(arguments)
    if options.quick:
        print_rows(run(True))
        return 0
    every = list(cases())
    saved = {row["case"] for row in saved_results(RESULTS).get("cases", [])}
    for name in [n for n in every if n not in saved] if options.only is None else options.only:
        found = run(False, [name])
        print_rows(found)
        save_results(RESULTS, with_saved(found, RESULTS, every))
    saved_cases = with_rule(saved_results(RESULTS))
    save_results(RESULTS, saved_cases | {"fit": fitted(saved_cases["cases"])})
    write_sections(Path(__file__).parents[1], RESULTS.stem, sections(saved_results(RESULTS)))
    return 0


def with_rule(results: Results) -> Results:
    """The results with today's rule, which needs no bricks."""
    every = cases()
    for row in results["cases"]:
        specimen = specimen_of(every[row["case"]])
        f = np.array([mode["ritz_hz"] for mode in row["modes"]])
        for mode, bias, sd in zip(row["modes"], *rule(specimen, f), strict=True):
            mode |= {"bias_percent": bias, "rule_percent": sd}
    return results


def rule(specimen: Specimen, f: Array) -> tuple[list[float], list[float]]:
    """Bias of the Ritz model and its remaining error, of frequencies f (n,), %."""
    common, powers = common_theory_errors(specimen), theory_powers(f)
    left = theory_error(specimen, f) ** 2 + sum((sd * powers[name]) ** 2 for name, sd in common.items())
    bias = f / theory_bias(specimen).of(f) - 1.0
    return (100.0 * bias).tolist(), (100.0 * np.sqrt(left)).tolist()


class Plate(NamedTuple):
    """Bending modes of a plate: ln of bricks over Ritz, error of the bricks, w; sums over its edges."""

    bias: Array
    bricks: Array
    shear: Array
    free: float
    clamped: float


# Start of the fit: bias by shear, common scatter by free edges and clamps, and of single modes by each.
_START = (0.009, 0.36, 0.01, 0.003, 0.2, 0.004)
_FLOOR, _FACTOR = 1e-4, 0.5


def fitted(rows: Sequence[Results]) -> Results:
    """Coefficients of the rule by maximum likelihood over all plates, and over every second one."""
    plates = [plate_of(row) for row in rows if rms(row, "bricks_error_percent") <= 1.0]
    every, half = most_likely(plates), most_likely(plates[::2])
    judged = [chi_squared(half, plate) / len(plate.bias) for plate in plates[1::2]]
    return {
        "coefficients": every.tolist(),
        "of_every_second_plate": half.tolist(),
        "chi_squared_of_the_others": judged,
    }


def plate_of(row: Results) -> Plate:
    """The plate of a results row."""
    modes = [m for m in row["modes"] if m["kind"] != "in-plane"]
    bias = np.log([m["bricks_hz"] / m["ritz_hz"] for m in modes])
    bricks = np.array([m["bricks_error_percent"] for m in modes]) / 100.0
    free, clamped = edge_sums(specimen_of(cases()[row["case"]]))
    return Plate(bias, bricks, np.array([m["shear_frequency"] for m in modes]), free, clamped)


def most_likely(plates: Sequence[Plate]) -> Array:
    """Maximum-likelihood coefficients, (6,)."""

    def objective(log: Array) -> float:
        return sum(chi_squared(np.exp(log), p) + log_determinant(np.exp(log), p) for p in plates)

    best = scipy.optimize.minimize(objective, np.log(_START), method="Nelder-Mead", options={"maxfev": 6000})
    return np.exp(best.x)


def chi_squared(coefficients: Array, plate: Plate) -> float:
    """r^T S^-1 r for the residuals r of a plate's modes about the bias."""
    r = plate.bias - coefficients[0] * plate.shear
    return float(r @ np.linalg.solve(covariance(coefficients, plate), r))


def log_determinant(coefficients: Array, plate: Plate) -> float:
    """ln det S."""
    return float(np.linalg.slogdet(covariance(coefficients, plate))[1])


def covariance(coefficients: Array, plate: Plate) -> Array:
    """Covariance S of a plate's modes: the error common to all and the error of each."""
    shear, free, clamps, *own = coefficients
    alone = _FLOOR**2 + plate.bricks**2 + (own[0] * plate.shear) ** 2
    alone = alone + (own[1] * plate.free) ** 2 + (own[2] * plate.clamped) ** 2
    level = (free * plate.free) ** 2 + (clamps * plate.clamped) ** 2
    return np.diag(alone) + (_FACTOR * shear) ** 2 * np.outer(plate.shear, plate.shear) + level


def sections(results: Results) -> dict[str, str]:
    """Section of docs/theory.md on the modes with the largest errors of the model."""
    return {"largest": _largest(results["cases"])}


def _largest(cases: Sequence[Results]) -> str:
    """The modes that the model makes too soft and too stiff by most, by the edges of the plate."""
    said = [f"Worst modes, Ritz model less bricks, where bricks are exact to {EXACT_BRICKS_PERCENT:g} %:"]
    exact = [c for c in cases if rms(c, "bricks_error_percent") <= EXACT_BRICKS_PERCENT]
    for words, chosen in (
        ("free all round", [c for c in exact if c["edges"] == "FFFF"]),
        ("with a clamped edge", [c for c in exact if "C" in c["edges"]]),
    ):
        modes = [(m["difference_percent"], c["case"]) for c in chosen for m in c["modes"]]
        if modes:
            (soft, softest), (stiff, stiffest) = min(modes), max(modes)
            said.append(f"plates {words} {soft:+.2f} % ({softest}) to {stiff:+.2f} % ({stiffest});")
    return paragraph(" ".join(said).rstrip(";") + ".")


def rms(case: Results, key: str) -> float:
    """Root mean square over the modes of a case."""
    return float(np.sqrt(np.mean([m[key] ** 2 for m in case["modes"]])))


def print_rows(results: Results) -> None:
    """Print one line per mode of each case."""
    for row in results["cases"]:
        print(row["case"])
        for m in row["modes"]:
            print(
                f"  {m['ritz_hz']:10.3f} Hz  Ritz - bricks {m['difference_percent']:+.3f} %,  "
                f"bricks within {m['bricks_error_percent']:.3f} %, "
                f"rule {m['bias_percent']:+.3f} +- {m['rule_percent']:.3f} %, {m['kind']}",
                flush=True,
            )


if __name__ == "__main__":
    sys.exit(main())
