"""How soft the core of a sandwich may be for first-order theory, against bricks.

python studies/22_sandwiches.py [--quick]

Plates of 240 x 180 mm with faces of 70 GPa and a foam core are solved twice with the same constants: by the
Ritz model and by CalculiX on 20-node bricks (C3D20R). Bricks are solved on two meshes, the finer with
twice as many elements in the plane, and extrapolated as in study 16; a third of the difference of the two
meshes is stated as their error.
"""

from __future__ import annotations

import argparse
import sys
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import cpam_bayes as cb
from cpam_bayes.forward_model.calculix.run import solve_modes
from cpam_bayes.forward_model.model import reference_constants
from cpam_bayes.forward_model.three_dimensions import LIMIT, sandwich_error
from cpam_bayes.plate import Specimen
from validation.reporting import paragraph, save_results, write_sections

Results = dict[str, Any]

RESULTS = Path(__file__).parent / "results" / f"{Path(__file__).stem}.json"

KEYS = {
    "quick": "whether this is the small version",
    "cases": "one sandwich: Ritz model and extrapolated bricks, mode by mode, and the error that is expected",
}

N_MODES = 8
FACE_GPA = 70.0
# Young's modulus of the faces over the shear modulus of the core.
RATIOS = (100, 300, 1000, 3000, 10_000, 30_000)
FACES = (0.05, 0.1, 0.2)
LENGTH_MM, WIDTH_MM = 240.0, 180.0
IN_PLANE = 110


class Case(NamedTuple):
    """A sandwich plate.

    face : thickness of a face over that of the plate
    ratio : Young's modulus of the faces over the shear modulus of the core
    """

    thickness_mm: float
    face: float
    ratio: float
    edges: str

    @property
    def name(self) -> str:
        """Name of the case in the results."""
        return f"h {self.thickness_mm:g} mm, faces {self.face:g} h, E/G {self.ratio:g}, {self.edges}"


def cases() -> list[Case]:
    """All sandwiches."""
    thick = [Case(10.0, face, ratio, "FFFF") for face, ratio in product(FACES, RATIOS)]
    others = ((10.0, "CFFF"), (5.0, "FFFF"))
    return thick + [Case(h, 0.1, ratio, edges) for h, edges in others for ratio in RATIOS]


def specimen_of(case: Case) -> Specimen:
    """The plate of a case."""
    face = case.face * case.thickness_mm
    core = {
        "symmetry": "isotropic",
        "E1_GPa": 2.6 * FACE_GPA / case.ratio,
        "nu12": 0.3,
        "density_kg_m3": 100.0,
    }
    return cb.read_plate(
        {
            "name": case.name,
            "plate": {
                "length_mm": LENGTH_MM,
                "width_mm": WIDTH_MM,
                "thickness_mm": case.thickness_mm,
                "layup": "[face/core/face]",
                "edges": case.edges,
            },
            "ply": [
                {"name": "face", "material": "face", "thickness_mm": face},
                {"name": "core", "material": "core", "thickness_mm": case.thickness_mm - 2.0 * face},
            ],
            "material": {
                "face": {"symmetry": "isotropic", "E1_GPa": FACE_GPA, "nu12": 0.3, "density_kg_m3": 2700.0},
                "core": core,
            },
        }
    )


def measured(case: Case, n_modes: int, in_plane: int) -> Results:
    """Results row of one sandwich; in_plane : elements in the plane of the finer mesh."""
    specimen = specimen_of(case)
    constants = reference_constants(specimen)
    ritz = cb.forward(specimen, n_modes).frequencies
    coarse, fine = (
        solve_modes(specimen, constants, n_modes, in_plane=n).frequencies for n in (in_plane // 2, in_plane)
    )
    bricks = fine - (coarse - fine) / 3.0
    expected = sandwich_error(specimen, ritz)
    return {
        "case": case.name,
        **case._asdict(),
        "modes": [
            {
                "ritz_hz": float(f),
                "bricks_hz": float(b),
                "too_low_percent": 100.0 * (1.0 - float(f) / float(b)),
                "bricks_error_percent": 100.0 * float(abs(c - g) / 3.0 / b),
                "expected_percent": 100.0 * float(e),
            }
            for f, b, c, g, e in zip(ritz, bricks, coarse, fine, expected, strict=True)
        ],
    }


def run(quick: bool) -> Results:
    """Results for all sandwiches; quick: a coarse one."""
    if quick:
        return {"quick": True, "cases": [measured(Case(10.0, 0.1, 1000.0, "FFFF"), 3, 36)]}
    rows = []
    for case in cases():
        rows.append(measured(case, N_MODES, IN_PLANE))
        print_row(rows[-1])
    return {"quick": False, "cases": rows}


def print_row(row: Results) -> None:
    """Print the worst mode of a sandwich."""
    print(
        f"{row['case']}: too low by {worst(row, 'too_low_percent'):.2f} %, expected "
        f"{worst(row, 'expected_percent'):.2f} %, bricks within {worst(row, 'bricks_error_percent'):.2f} %",
        flush=True,
    )


def worst(row: Results, key: str) -> float:
    """The largest value over the modes of a sandwich."""
    return float(max(mode[key] for mode in row["modes"]))


def sections(results: Results) -> dict[str, str]:
    """Section of docs/hybrids.md on how far the expected error holds."""
    return {"agreement": _agreement(results)}


def _agreement(results: Results) -> str:
    modes = [mode for row in results["cases"] for mode in row["modes"]]
    said = [m for m in modes if 0.5 <= m["expected_percent"] <= 100.0 * LIMIT]
    low, high = (float(f([m["too_low_percent"] / m["expected_percent"] for m in said])) for f in (min, max))
    beyond = [m for m in modes if m["expected_percent"] > 100.0 * LIMIT]
    least = min(m["too_low_percent"] for m in beyond)
    calm = [m for m in modes if m["expected_percent"] < 0.5]
    most = max(m["too_low_percent"] for m in calm)
    return paragraph(
        f"Against bricks on {len(results['cases'])} sandwiches (`python studies/22_sandwiches.py`), "
        f"frequencies are too low by at most {most:.2f} % where e is below 0.5 %; by {low:.2f} to {high:.2f} "
        f"times e where e is 0.5 to {100.0 * LIMIT:g} %; and by {least:.1f} % or more where e is larger, "
        "mostly by less than e."
    )


def main(arguments: list[str] | None = None) -> int:
    """Run, save and write the page."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--quick", action="store_true")
    if parser.parse_args(arguments).quick:
        for row in run(True)["cases"]:
            print_row(row)
        return 0
    results = run(False)
    save_results(RESULTS, results)
    write_sections(Path(__file__).parents[1], RESULTS.stem, sections(results))
    return 0


if __name__ == "__main__":
    sys.exit(main())
