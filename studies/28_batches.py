"""Are the verdicts of a batch right: a mass left on, a thin plate, two near the limit, eight good ones?

python studies/28_batches.py [--quick] [--minutes M] [--development]

Twenty drawn batches of twelve plates against a limit on E1. Eight plates are well above it and should pass;
one of these has an accelerometer left on and cannot be judged; one is thinner than stated and fails; two have
an E1 within half a standard deviation of the limit and are too close to call. Lists are of elements that are
independent of the package, with 0.1 to 0.3 % of noise.

`--development` draws other batches, prints each and saves nothing.
"""

from __future__ import annotations

import sys
import time
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm

import cpam_bayes as cb
from cpam_bayes.questions.batch.result import SURE, verdict
from cpam_bayes.questions.batch.verdicts import four_verdicts
from cpam_bayes.render.report import Heading, Table
from cpam_bayes.render.terminal import screen_text
from validation.independent.true_plate import Mass, TruePlate, natural_frequencies
from validation.laboratory import REFERENCES, material_tables
from validation.reporting import Results, case_by_case, cases_main, markdown_table, paragraph

Array = NDArray[np.float64]
RESULTS = Path(__file__).parent / "results" / f"{Path(__file__).stem}.json"

KEYS = {
    "quick": "whether this is the small version",
    "verdicts": "one for each kind of plate: how often each verdict was given",
    "cases": "one a batch: noise, the verdicts by plate, the first line, seconds",
}

BATCHES = 20
# Seeds of the batches that are reported and of those inspected before.
REPORTED, DEVELOPMENT = 28, 2800
N_MODES = 10
NOISES = (1e-3, 3e-3)
# Relative scatter of a constant from plate to plate, and of a gauged thickness about the true one.
SCATTER, GAUGED = 0.015, 0.002
# Limit on E1 relative to the batch mean; standard deviation of E1 by which near-limit plates are placed.
LIMIT, OF_E1 = 0.92, 0.01
# Largest distance of such a plate from the limit, in these standard deviations.
NEAR = 0.5
VERDICTS = ("pass", "fail", "cannot be judged", "too close to call")
RIGHT = {
    "good": "pass",
    "thin": "fail",
    "mass left on": "cannot be judged",
    "near the limit": "too close to call",
}
PLATES = ("good",) * 8 + ("thin", "mass left on", "near the limit", "near the limit")

# with lists that determine E1 to about 1 %
HALVES = ((0.0, 90.0) * 2, (0.0,) * 4)


def plates_of(rng: np.random.Generator, kinds: tuple[str, ...]) -> tuple[list[dict[str, Any]], str, float]:
    """Plate files of a batch, its limit and its noise."""
    reference, density = REFERENCES[str(rng.choice(list(REFERENCES)))]
    half = HALVES[int(rng.integers(len(HALVES)))]
    length = round(rng.uniform(0.2, 0.35), 3)
    nominal = TruePlate(
        length=length,
        width=round(length * rng.uniform(0.55, 0.9), 3),
        thickness=round(rng.uniform(1.6, 3.2), 1) * 1e-3,
        density=density,
        edges="FFFF",
        angles_deg=(*half, *half[::-1]),
        constants=reference,
    )
    noise = float(np.exp(rng.uniform(*np.log(NOISES))))
    limit = LIMIT * reference["E1"]
    files = []
    for i, kind in enumerate(kinds):
        constants = {n: v * float(np.exp(SCATTER * rng.standard_normal())) for n, v in reference.items()}
        if kind == "near the limit":
            constants["E1"] = limit * (1.0 + OF_E1 * rng.uniform(-NEAR, NEAR))
        stated = nominal.thickness * float(np.exp(0.01 * rng.standard_normal()))
        true = replace(
            nominal, constants=constants, thickness=stated * float(np.exp(GAUGED * rng.standard_normal()))
        )
        if kind == "thin":
            true = replace(true, thickness=true.thickness * (1.0 - rng.uniform(0.04, 0.08)))
        if kind == "mass left on":
            x, y = rng.uniform(0.1, 0.9, 2) * (true.length, true.width)
            true = replace(true, masses=(Mass(rng.uniform(0.02, 0.06) * true.total_mass, x, y),))
        f = natural_frequencies(true, N_MODES) * (1.0 + noise * rng.standard_normal(N_MODES))
        files.append(_file_of(f"b{i + 1:02d}", true, stated, np.sort(f), noise, reference))
    return files, f"E1_GPa >= {1e-9 * limit:.4g}", noise


def _file_of(
    name: str, plate: TruePlate, thickness: float, f: Array, noise: float, reference: dict[str, float]
) -> dict[str, Any]:
    return {
        "name": name,
        "plate": {
            "length_mm": 1e3 * plate.length,
            "width_mm": 1e3 * plate.width,
            "thickness_mm": round(1e3 * thickness, 4),
            "mass_g": round(1e3 * plate.total_mass, 2),
            "layup": f"[{'/'.join(f'{a:g}' for a in plate.angles_deg)}]",
            "edges": plate.edges,
            "sd": {"thickness_mm": 1e3 * GAUGED * thickness},
        },
        **material_tables(reference),
        "measurement": {
            "frequencies_hz": [float(f"{value:.5g}") for value in f],
            "relative_std": float(f"{noise:.2g}"),
        },
    }


def case(number: int, seed: int = REPORTED, kinds: tuple[str, ...] = PLATES) -> Results:
    """One batch and the verdict of `batch` on each of its plates."""
    start, rng = time.perf_counter(), np.random.default_rng([seed, number])
    kinds = tuple(kinds[i] for i in rng.permutation(len(kinds)))
    files, limit, noise = plates_of(rng, kinds)
    answer = cb.batch(*files, limits=[limit], seed=0)
    return {
        "case": number,
        "noise": noise,
        "kinds": list(kinds),
        "verdicts": [verdict(answer, row) for row in answer.rows],
        "first_line": four_verdicts(answer),
        "seconds": round(time.perf_counter() - start, 1),
    }


def results_of(cases: list[Results], quick: bool) -> Results:
    given = [pair for one in cases for pair in zip(one["kinds"], one["verdicts"], strict=True)]
    verdicts = [
        {"kind": kind} | {said: sum(pair == (kind, said) for pair in given) for said in VERDICTS}
        for kind in RIGHT
    ]
    return {"quick": quick, "verdicts": verdicts, "cases": cases}


def run(quick: bool, minutes: float = float("inf")) -> Results:
    """Results of all batches, those not yet saved being computed; quick: one of two plates."""
    if quick:
        return results_of([case(0, DEVELOPMENT, ("good", "thin"))], quick)
    return case_by_case(range(BATCHES), case, lambda c: results_of(c, False), minutes=minutes, path=RESULTS)


def called_by_noise() -> float:
    """Probability that a plate near the limit gets a firm verdict, by a scatter as large as stated."""
    away = np.linspace(-NEAR, NEAR, 101)
    return float(np.mean(norm.sf(norm.ppf(SURE) - away) + norm.sf(norm.ppf(SURE) + away)))


def whole_by_the_rule(batches: int) -> float:
    """Expected number of batches with all verdicts right, if those far from the limit are."""
    return batches * (1.0 - called_by_noise()) ** PLATES.count("near the limit")


def sections(results: Results) -> dict[str, str]:
    """Table of a page with the verdicts by kind of plate."""
    cases, rows = results["cases"], results["verdicts"]
    whole = sum(all(RIGHT[k] == v for k, v in zip(c["kinds"], c["verdicts"], strict=True)) for c in cases)
    said = (
        f"{len(cases)} batches of twelve plates were simulated with independent finite elements, plus noise "
        f"of 0.1 to 0.3 %. All twelve verdicts were right in {whole} batches "
        f"({whole_by_the_rule(len(cases)):.1f} expected: noise takes "
        f"{100.0 * called_by_noise():.0f} % of plates near the limit past a probability of {SURE:g}):"
    )
    table = [
        (row["kind"], *(f"**{row[v]}**" if RIGHT[row["kind"]] == v else str(row[v]) for v in VERDICTS))
        for row in rows
    ]
    return {"verdicts": f"{paragraph(said)}\n\n{markdown_table(('plate', *VERDICTS), table)}"}


def show(results: Results) -> None:
    rows = tuple((row["kind"], *(str(row[said]) for said in VERDICTS)) for row in results["verdicts"])
    columns = (Heading("plate"), *(Heading(said, number=True) for said in VERDICTS))
    print(screen_text((Table("Plates by verdict", columns, rows),), sys.stdout))


def main() -> None:
    others = partial(
        case_by_case,
        range(BATCHES),
        partial(case, seed=DEVELOPMENT),
        partial(results_of, quick=True),
    )
    cases_main(__doc__, run, show, RESULTS, others)


if __name__ == "__main__":
    main()
