"""First light: the paper's thin plates identified by the swarm, and how exact the plate model is.

python studies/01_first_light.py [--quick]
"""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import cpam_bayes as cb
from cpam_bayes.forward_model.build import forget_models
from cpam_bayes.forward_model.model import NO_PARAMETERS, PlateModel, converged_model, plate_problem
from cpam_bayes.inference.swarm import SwarmSettings
from cpam_bayes.mechanics.convergence import Tolerance
from cpam_bayes.plate import Specimen, to_user
from cpam_bayes.plate.laminate import ENERGY_CONSISTENT, FIVE_SIXTHS, ShearModel
from cpam_bayes.plate.layup import parse_layup
from cpam_bayes.render.report import Heading, Table, remarks
from cpam_bayes.render.terminal import screen_text
from cpam_bayes.running import single_blas_thread
from validation.reporting import (
    study_main,
)

RESULTS = Path(__file__).parent / "results" / f"{Path(__file__).stem}.json"

KEYS = {
    "quick": "whether this is the small version",
    "identifications": "one a plate: constants with sd, verdict and reference; frequencies; work and seconds",
    "forward_errors": "one a reference: its values, the solver's, the worst error and the estimated one",
    "solves": "time and size of one converged forward solve",
}

THIN_PLATES = ("D&G", "A1", "A2", "B1", "B2", "C1", "C2", "C3", "C4")
SEED = 0
REFERENCE = np.empty((1, 0))  # the reference constants: no parameter varies

# Leissa, The free vibration of rectangular plates, J. Sound Vib. 31 (1973): omega a^2 sqrt(rho h / D) of thin
# square plates, nu = 0.3. Upper bounds from a Ritz basis of 36 products: the free square's are converged to
# the last digit, the cantilever's are up to 0.15 % high.
LEISSA = {
    "FFFF": ([13.468, 19.596, 24.270, 34.801, 34.801, 61.093], 0.1),
    "CFFF": ([3.4711, 8.5062, 21.284, 27.199, 30.955, 54.187], 0.2),
}
# Hz, converged with two bases of an independent program, which agree to 2e-6; shear factor 5/6.
CONVERGED = {
    "C1": [100.366, 298.584, 324.574, 360.347, 381.139, 600.611],
    "A2": [40.9165, 90.673, 240.069, 276.238, 340.704, 566.456],
    "D1": [1351.155, 3015.301, 3150.239, 4044.149, 4055.798, 6775.498, 8143.114, 8273.099,
           8849.348, 9154.067],
}  # fmt: skip
# Simply supported plates, which have Navier's exact solution: layup, thickness in m.
NAVIER = {
    "orthotropic, thin": ("[0]", 0.001),
    "orthotropic, thick": ("[0]", 0.02),
    "cross-ply, thin": ("[(0/90)_8]_s", 0.0032),
    "cross-ply, thick": ("[(0/90)_8]_s", 0.03),
    "[0/90], thin": ("[0/90]", 0.004),
    "[0/90], thick": ("[0/90]", 0.03),
}
# Promised accuracy, percent of a frequency, of a thin plate and of one thicker than side / 40.
THIN_PERCENT, THICK_PERCENT = 0.02, 0.05


@single_blas_thread
def run(quick: bool) -> dict[str, Any]:
    """Results for all plates and references; quick: A1 with a small swarm, one reference of each kind."""
    plates = ("A1",) if quick else THIN_PLATES
    settings = SwarmSettings(particles=8, iterations=3) if quick else SwarmSettings()
    errors = [_against_navier(name) for name in (["orthotropic, thin"] if quick else NAVIER)]
    errors += [_against_converged(name) for name in (["C1"] if quick else CONVERGED)]
    errors += [] if quick else [_against_leissa(edges) for edges in LEISSA]
    return {
        "quick": quick,
        "identifications": [_identified(cb.read_plate(name), settings) for name in plates],
        "forward_errors": errors,
        "solves": [
            _solve_time(cb.read_plate(name), 3 if quick else 200)
            for name in (("C1",) if quick else ("C1", "D1"))
        ],
    }


# Identification


def _identified(specimen: Specimen, settings: SwarmSettings) -> dict[str, Any]:
    """Results for one plate, timed with the reduced model still to be built and again with the stored one."""
    forget_models()
    first, again = (cb.identify(specimen, seed=SEED, settings=settings).to_dict() for _ in range(2))
    keys = ("frequencies", "rms_percent", "noise_percent", "forward_solves", "seconds", "warnings")
    material_sd = {name: to_user(name, sd) for name, sd in specimen.material.sd.items()}
    return {
        "plate": specimen.name,
        "layup": specimen.plate.layup.text,
        "edges": specimen.plate.edges,
        "constants": {
            name: _constant(c, material_sd.get(name.removesuffix("_GPa"), 0.0))
            for name, c in first["constants"].items()
        },
        **{key: first[key] for key in keys},
        "solver_error_percent": 100.0 * first["relative_error_estimate"],
        "swarm": first["status"],
        "seconds_model_on_disk": again["seconds"],
    }


def _constant(found: dict[str, Any], reference_sd: float) -> dict[str, Any]:
    """Row of a constant; agrees : within two joint sd of the reference, ``None`` if undecided."""
    value, reference = found["value"], found["reference"]
    decided = found["bound"] is None and found["verdict"] != "determined by the prior"
    return {
        **{key: found[key] for key in ("value", "sd", "reference", "verdict", "bound")},
        "reference_sd": reference_sd,
        "percent": 100.0 * (value / reference - 1.0),
        "agrees": abs(value - reference) <= 2.0 * math.hypot(found["sd"], reference_sd) if decided else None,
    }


# The forward solver against references


def _against_navier(name: str) -> dict[str, Any]:
    layup, thickness = NAVIER[name]
    specimen = _plate(cb.read_plate("C1"), 0.3, 0.2, thickness, "SSSS", layup)
    model = converged_model(specimen, NO_PARAMETERS, 10)
    exact = navier(specimen, 10)
    allowed = THIN_PERCENT if thickness < 0.2 / 40 else THICK_PERCENT
    return _error(f"SSSS {name}", "Navier, exact", "Hz", exact, _solved(model), allowed, model.error)


def navier(specimen: Specimen, n_modes: int, highest: int = 12) -> np.ndarray:
    """Frequencies of a simply supported cross-ply plate by Navier's solution, (n_modes,) Hz.

    With u = U cos(ax) sin(by), v = V sin cos, w = W sin sin, phi_x = X cos sin, phi_y = Y sin cos
    With u = U cos(ax) sin(by), v = V sin cos, w = W sin sin, phi_x = X cos sin, phi_y = Y sin cos,
    an eigenproblem of five unknowns (Reddy, Mechanics of Laminated Composite Plates, section 7.2).
    """
    plate, state = specimen.plate, plate_problem(specimen).nominal
    c = np.real(state.stiffness())
    inertia = plate.density * plate.thickness * np.array([1, 1, 1, *[plate.thickness**2 / 12] * 2])
    found = []
    for m in range(highest + 1):
        for n in range(highest + 1):
            a, b = m * np.pi / plate.length, n * np.pi / plate.width
            strain = np.zeros((8, 5))
            strain[[0, 1, 2, 2], [0, 1, 0, 1]] = -a, -b, b, a
            strain[[3, 4, 5, 5], [3, 4, 3, 4]] = -a, -b, b, a
            strain[[6, 6, 7, 7], [2, 4, 2, 3]] = b, 1, a, 1
            present = [n > 0, m > 0, m > 0 and n > 0, n > 0, m > 0]
            k = (strain.T @ c @ strain)[np.ix_(present, present)]
            scale = 1 / np.sqrt(inertia[present])
            found.append(np.linalg.eigvalsh(k * scale[:, None] * scale))
    return np.sqrt(np.sort(np.concatenate(found))[:n_modes]) / (2 * np.pi)


def _against_converged(name: str) -> dict[str, Any]:
    reference = np.array(CONVERGED[name])
    model = converged_model(cb.read_plate(name), NO_PARAMETERS, len(reference), FIVE_SIXTHS)
    allowed = THICK_PERCENT if name.startswith("D") else THIN_PERCENT
    source = "converged by two bases of an independent program"
    return _error(f"{name}, shear factor 5/6", source, "Hz", reference, _solved(model), allowed, model.error)


def _against_leissa(edges: str) -> dict[str, Any]:
    """Frequency parameters at h / a = 1/100 and 1/200, extrapolated linearly to the thin limit.

    The twisting layer of a free edge makes the frequencies approach Kirchhoff's only linearly in h / a. The
    extrapolation multiplies the errors of the frequencies by up to three, hence a tighter tolerance.
    """
    reference, allowed = LEISSA[edges]
    parameters, errors = [], []
    for h in (0.01, 0.005):
        specimen = _isotropic(_plate(cb.read_plate("D&G"), 1.0, 1.0, h, edges, None), 70e9, 0.3)
        model = converged_model(specimen, NO_PARAMETERS, len(reference), FIVE_SIXTHS, Tolerance(2e-5, 1e-5))
        rigidity = np.real(plate_problem(specimen).nominal.stiffness())[3, 3]
        scale = np.sqrt(specimen.plate.density * h / rigidity)
        parameters.append(2 * np.pi * _solved(model) * scale)
        errors.append(model.error)
    found = 2 * parameters[1] - parameters[0]
    name = f"{edges} square, h to 0"
    source = "Leissa (1973)"
    return _error(name, source, "1", np.array(reference), found, allowed, 2 * errors[1] + errors[0])


def _error(
    case: str,
    source: str,
    unit: str,
    reference: np.ndarray,
    found: np.ndarray,
    allowed: float,
    estimate: np.ndarray,
) -> dict[str, Any]:
    error = 100.0 * (found / reference - 1.0)
    worst = int(np.argmax(np.abs(error)))
    return {
        "case": case,
        "source": source,
        "unit": unit,
        "reference": [float(f) for f in reference],
        "found": [float(f) for f in found],
        "worst_percent": float(error[worst]),
        "worst_mode": worst + 1,
        "estimate_percent": 100.0 * float(np.max(estimate)),
        "allowed_percent": allowed,
        "passes": bool(abs(error[worst]) <= allowed),
    }


def _solved(model: PlateModel) -> np.ndarray:
    return model.predict(REFERENCE).frequencies[0]


def _plate(
    specimen: Specimen, length: float, width: float, thickness: float, edges: str, layup: str | None
) -> Specimen:
    """The material of a built-in specimen on another plate."""
    own = specimen.plate.layup if layup is None else parse_layup(layup)
    plate = replace(
        specimen.plate, length=length, width=width, thickness=thickness, edges=edges, layup=own, mass=None
    )
    return replace(specimen, plate=plate)


def _isotropic(specimen: Specimen, modulus: float, ratio: float) -> Specimen:
    return replace(specimen, material=replace(specimen.material, constants={"E1": modulus, "nu12": ratio}))


# Time of one solve


def _solve_time(specimen: Specimen, repeats: int, shear: ShearModel = ENERGY_CONSISTENT) -> dict[str, Any]:
    measurement = specimen.measurement
    assert measurement is not None
    start = time.perf_counter()
    model = converged_model(specimen, NO_PARAMETERS, measurement.size, shear)
    building = time.perf_counter() - start
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        model.predict(REFERENCE)
        times.append(time.perf_counter() - start)
    return {
        "plate": specimen.name,
        "modes": measurement.size,
        "blocks": [block.size for block in model.operator.blocks],
        "error_percent": 100.0 * float(np.max(model.error)),
        "milliseconds": 1e3 * float(np.median(times)),
        "seconds_to_converge": building,
    }


# Output


def show(results: dict[str, Any]) -> None:
    """Print the results as tables."""
    found = results["identifications"]
    constants = ("plate", "constant", "value", "sd", "reference", "off %", "verdict", "within 2 sd")
    frequencies = ("plate", "mode", "label", "kind", "measured Hz", "predicted Hz", "residual %")
    work = ("plate", "rms %", "swarm", "forward solves", "s", "s, model on disk", "solver error %")
    forward = ("case", "reference", "modes", "worst %", "of mode", "estimated %", "allowed %", "")
    solves = ("plate", "modes", "ms", "estimated error %", "s to converge", "trial functions by block")
    tables = (
        Table(f"Constants by the swarm, seed {SEED}", _columns(constants), _constant_rows(found)),
        Table("Frequencies", _columns(frequencies), _frequency_rows(found)),
        Table("Work", _columns(work), _work_rows(found)),
        remarks("Warnings", tuple(f"{f['plate']}: {text}" for f in found for text in f["warnings"])),
        Table(
            "Forward solver against references", _columns(forward), _forward_rows(results["forward_errors"])
        ),
        Table("One converged forward solve", _columns(solves), _solve_rows(results["solves"])),
    )
    print(screen_text(tables, sys.stdout))


_TEXT = {"plate", "constant", "label", "kind", "swarm", "verdict", "within 2 sd", "case", "reference", ""}


def _columns(headings: Sequence[str]) -> tuple[Heading, ...]:
    return tuple(Heading(heading, heading not in _TEXT) for heading in headings)


Rows = tuple[tuple[str, ...], ...]


def _constant_rows(found: list[dict[str, Any]]) -> Rows:
    agrees = {True: "yes", False: "NO", None: "-"}
    return tuple(
        (
            f["plate"],
            name,
            *(f"{c['value']:.4g}", "-" if c["sd"] is None else f"{c['sd']:.2g}"),
            *(f"{c['reference']:.4g}", f"{c['percent']:+.1f}"),
            *(c["verdict"], agrees[c["agrees"]]),
        )
        for f in found
        for name, c in f["constants"].items()
    )


def _frequency_rows(found: list[dict[str, Any]]) -> Rows:
    return tuple(
        (
            *(f["plate"], str(i), mode["label"], mode["kind"]),
            *(f"{mode['measured_hz']:g}", f"{mode['predicted_hz']:.2f}", f"{mode['residual_percent']:+.2f}"),
        )
        for f in found
        for i, mode in enumerate(f["frequencies"], 1)
    )


def _work_rows(found: list[dict[str, Any]]) -> Rows:
    return tuple(
        (
            *(f["plate"], f"{f['rms_percent']:.2f}", f["swarm"], str(f["forward_solves"])),
            *(f"{f['seconds']:.1f}", f"{f['seconds_model_on_disk']:.2f}", f"{f['solver_error_percent']:.3f}"),
        )
        for f in found
    )


def _forward_rows(errors: list[dict[str, Any]]) -> Rows:
    return tuple(
        (
            *(e["case"], e["source"], str(len(e["reference"]))),
            *(f"{e['worst_percent']:+.4f}", str(e["worst_mode"]), f"{e['estimate_percent']:.4f}"),
            *(f"{e['allowed_percent']:g}", "pass" if e["passes"] else "FAIL"),
        )
        for e in errors
    )


def _solve_rows(solves: list[dict[str, Any]]) -> Rows:
    return tuple(
        (
            *(s["plate"], str(s["modes"]), f"{s['milliseconds']:.2f}", f"{s['error_percent']:.4f}"),
            *(f"{s['seconds_to_converge']:.2f}", " ".join(str(n) for n in s["blocks"])),
        )
        for s in solves
    )


def main() -> None:
    study_main(__doc__, run, show, RESULTS)


if __name__ == "__main__":
    main()
