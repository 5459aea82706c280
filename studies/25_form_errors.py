"""How much of what a cause does to a real plate the catalogue's form of it misses.

python studies/25_form_errors.py [--quick]

A clamp lets go abruptly, an accelerometer has a footprint and a cable, foam supports are small: plates with
such forms are solved on elements that are independent of the package, and their shifts of ln f are fitted by
the catalogue's effect, by least squares in its size, place and direction within its priors. kappa is the rms
residual over the modes, relative to that of the shift: once with the constants fixed, once with the constants
free to imitate what they can.
"""

from __future__ import annotations

import sys
import tomllib
from functools import lru_cache
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

import cpam_bayes as cb
from cpam_bayes.diagnosis.cases import plate_case
from cpam_bayes.diagnosis.comparison import PlateCase
from cpam_bayes.diagnosis.models import extended_model
from cpam_bayes.effects import CATALOGUE, Effect, variants
from cpam_bayes.forward_model.model import ForwardModel, reference_vector
from cpam_bayes.render.report import Heading, Table
from cpam_bayes.render.terminal import screen_text
from validation.independent.forms import FORMS, Bench, Place, bench
from validation.independent.lists import NominalPlate
from validation.independent.true_plate import TruePlate
from validation.reporting import study_main

Array = NDArray[np.float64]
Results = dict[str, Any]
RESULTS = Path(__file__).parent / "results" / f"{Path(__file__).stem}.json"

KEYS = {
    "quick": "whether this is the small version",
    "effects": "one a cause: root mean square, median and 90 % of kappa over plates, forms and sizes",
    "cases": "one a plate, form, size and place: rms of the shift, and kappa, constants held and free",
}

N_MODES = 10
# Relative noise of the lists, which determines the accuracy of the catalogue's models.
NOISE = 5e-4
# Initial sizes of the fits, in the catalogue's standard deviations, and number of the best continued.
STARTS, GO_ON = (0.3, 1.0, 3.0), 2
# Fractions of the range of an extent, a radius of gyration or a direction.
FRACTIONS = (0.15, 0.5, 0.85)

CARBON = {"E1": 132e9, "E2": 8.8e9, "nu12": 0.29, "G12": 4.9e9}
GLASS = {"E1": 41e9, "E2": 10.4e9, "nu12": 0.27, "G12": 4.1e9}
METAL = {"E1": 71e9, "nu12": 0.33}


def _plate(
    name: str,
    size_mm: tuple[float, float, float],
    density: float,
    edges: str,
    layup: str,
    half_deg: tuple[float, ...],
    constants: dict[str, float],
) -> NominalPlate:
    sides = (1e-3 * s for s in size_mm)
    angles = (*half_deg, *half_deg[::-1])
    material = "aluminium" if "E2" not in constants else "carbon" if constants is CARBON else "glass"
    return NominalPlate(
        name, TruePlate(*sides, density, edges, angles, constants), layup, material, True, N_MODES
    )


PLATES = (
    _plate("cross-ply", (268, 172, 2.2), 1575, "FFFF", "[(90/0)_2]_s", (90.0, 0.0) * 2, CARBON),
    _plate(
        "quasi-isotropic", (232, 208, 2.7), 1930, "FFFF", "[0/45/-45/90]_s", (0.0, 45.0, -45.0, 90.0), GLASS
    ),
    _plate("one direction", (242, 128, 1.7), 1570, "FFFF", "[0_8]", (0.0,) * 4, CARBON),
    _plate("cross-ply, clamped", (205, 155, 2.4), 1930, "CFFF", "[(0/90)_2]_s", (0.0, 90.0) * 2, GLASS),
    _plate("one direction, clamped", (235, 110, 2.1), 1575, "CFFF", "[0_10]", (0.0,) * 5, CARBON),
    _plate("metal, clamped", (160, 198, 2.0), 2700, "CFFF", "[0_2]", (0.0,), METAL),
)


def run(quick: bool) -> Results:
    """Results for all forms on all plates; quick: two fast ones on one plate."""
    cases = []
    for nominal in PLATES[:1] if quick else PLATES:
        on = bench(nominal.plate, N_MODES)
        text = nominal.file([float(f) for f in on.frequencies], stated=NOISE)
        case = plate_case(cb.read_plate(tomllib.loads(text)))
        for effect in CATALOGUE:
            if effect.name in ("taper_x", "support") or not quick:
                cases += _of_effect(nominal.name, on, case, effect)
    return {"quick": quick, "effects": _summary(cases), "cases": cases}


def _of_effect(plate: str, on: Bench, case: PlateCase, effect: Effect) -> list[Results]:
    forms = [form for form in FORMS if form.cause == effect.name]
    if not forms or not effect.applies_to(case.models.facts):
        return []
    catalogue = [(own, extended_model(case.models, own)) for own in variants(effect, case.models.facts)]
    rows = []
    for form in forms:
        for size, place in product(form.sizes, form.places):
            shift = on.solved(form.act(on, size, place)) - np.log(on.frequencies)
            left = np.array([_left(case, own, model, shift, place) for own, model in catalogue])
            held, free = left.min(axis=0) / _rms(shift)
            rows.append(
                {
                    "cause": effect.name,
                    "form": form.name,
                    "plate": plate,
                    "size": size,
                    "place": place,
                    "shift_percent": 100.0 * _rms(shift),
                    "kappa": float(held),
                    "kappa_free": float(free),
                }
            )
    return rows


def _left(
    case: PlateCase, effect: Effect, model: ForwardModel, shift: Array, place: Place
) -> tuple[float, float]:
    """Rms residual of a shift after the catalogue's best fit, with the constants fixed and free."""
    x = reference_vector(case.models.specimen, case.models.parameters)
    starts = _starts(effect, place)
    null = starts[0].copy()
    null[: len(effect.sizes)] = [effect.null[p.name] for p in effect.sizes]
    ends = np.array([[p.prior.lower for p in effect.parameters], [p.prior.upper for p in effect.parameters]])

    def ln_f(values: Array) -> Array:
        rows = np.column_stack((np.repeat(x[None], len(values), axis=0), values))
        return np.asarray(np.log(model.predict(rows).frequencies[:, :N_MODES]))

    target = shift + ln_f(null[None])[0]

    @lru_cache(maxsize=2)
    def at(values: tuple[float, ...]) -> tuple[Array, Array]:
        found = model.predict(np.array([[*x, *values]]), jacobian=True)
        assert found.jacobian is not None
        slope = found.jacobian[0, :N_MODES, len(x) :] / found.frequencies[0, :N_MODES, None]
        return np.log(found.frequencies[0, :N_MODES]) - target, slope

    def fitted(start: Array, counted: Array) -> Any:
        """counted : matrix (n_modes, n_modes) that removes from a shift what does not count"""
        return least_squares(
            lambda v: counted @ at(tuple(v))[0],
            start,
            lambda v: counted @ at(tuple(v))[1],
            (ends[0], ends[1]),
            x_scale=ends[1] - ends[0],
        )

    first = np.sum((ln_f(starts) - target) ** 2, axis=1)
    held = min(
        (fitted(starts[i], np.eye(N_MODES)) for i in np.argsort(first)[:GO_ON]), key=lambda fit: fit.cost
    )
    return _rms(held.fun), _rms(fitted(held.x, _beyond_constants(case)).fun)


def _starts(effect: Effect, place: Place) -> Array:
    """Starting values of an effect's parameters, sizes first, within their priors."""
    at = [
        [s * sd * p.prior.typical for s in STARTS for sd in ((1.0, -1.0) if p.prior.lower < 0.0 else (1.0,))]
        for p in effect.sizes
    ]
    placed = len(effect.coordinates) > 2
    further = effect.coordinates[2:] if placed else effect.coordinates
    at += [[c] for c in place] if placed else []
    at += [[p.prior.lower + s * (p.prior.upper - p.prior.lower) for s in FRACTIONS] for p in further]
    ends = [(p.prior.lower, p.prior.upper) for p in effect.parameters]
    return np.clip(np.array(list(product(*at))), *np.array(ends).T * np.array([[1.0], [1.0 - 1e-9]]))


def _beyond_constants(case: PlateCase) -> Array:
    """Projector that removes from a shift the part that changes of the constants, of any size, imitate."""
    x = reference_vector(case.models.specimen, case.models.parameters)
    found = case.models.bare.predict(x[None], jacobian=True)
    assert found.jacobian is not None
    by_constants = (found.jacobian[0] * x / found.frequencies[0][:, None])[:N_MODES]
    return np.eye(N_MODES) - by_constants @ np.linalg.pinv(by_constants)


def _rms(values: Any) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def _summary(cases: list[Results]) -> list[Results]:
    rows = []
    for cause in dict.fromkeys(c["cause"] for c in cases):
        held, free = ([c[key] for c in cases if c["cause"] == cause] for key in ("kappa", "kappa_free"))
        row = {"cause": cause, "cases": len(held)}
        for key, kappas in (("", held), ("_free", free)):
            row |= {f"rms{key}": _rms(kappas), f"median{key}": float(np.median(kappas))}
            row |= {f"most{key}": float(np.quantile(kappas, 0.9))}
        rows.append(row)
    return rows


def show(results: Results) -> None:
    """Print kappa of every cause."""
    names = ("cause", "cases", "rms", "median", "90 %", "rms, constants free", "median", "90 %")
    columns = tuple(Heading(name, number=i > 0) for i, name in enumerate(names))
    keys = ("rms", "median", "most", "rms_free", "median_free", "most_free")
    rows = tuple(
        (row["cause"], str(row["cases"]), *(f"{row[key]:.3f}" for key in keys)) for row in results["effects"]
    )
    print(screen_text((Table("kappa, of the shift of a real form", columns, rows),), sys.stdout))


def main() -> None:
    study_main(__doc__, run, show, RESULTS)


if __name__ == "__main__":
    main()
