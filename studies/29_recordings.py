"""Are plates identified from recorded hits: is each peak taken for its mode, do intervals hold the constants?

python studies/29_recordings.py [--quick] [--minutes M] [--development]

Fifty plates of elements that are independent of the package, hit one to six times. Recordings have the
defects of real ones: hum, a second stroke, a clipped file, background noise, drifting modes, modes missing
because the sensor sits at a node, and resonances that are not the plate's. `identify` answers from them.

`--development` draws other plates, prints each and saves nothing.
"""

from __future__ import annotations

import sys
import tempfile
import time
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.io import wavfile

import cpam_bayes as cb
from cpam_bayes.inference.ensemble import EnsembleSettings
from cpam_bayes.plate import read_plate, user_name
from cpam_bayes.render.report import Heading, Table
from cpam_bayes.render.terminal import screen_text
from validation.independent.true_plate import TruePlate, natural_frequencies
from validation.laboratory import REFERENCES, material_tables
from validation.recorded_hits import RATE, Faults, recorded_hits
from validation.reporting import Results, case_by_case, cases_main, paragraph

Array = NDArray[np.float64]
RESULTS = Path(__file__).parent / "results" / f"{Path(__file__).stem}.json"

KEYS = {
    "quick": "whether this is the small version",
    "counts": "plates whose peaks are all right, or the wrong ones stated as doubtful; constants in their "
    "intervals, with the standard error by plate; seconds of the recordings",
    "cases": "one a plate: faults, hits, peaks (Hz, true and taken mode, probability), constants, seconds",
}

PLATES = 50
# Seeds of the plates that are reported and of those inspected before.
REPORTED, DEVELOPMENT = 37, 2900
LAYUPS = ("[0/90/0/90]_s", "[0/45/-45/90]_s", "[0_8]", "[90/0/0/0]_s")
EDGES = ("FFFF", "FFFF", "FFFF", "CFFF", "CFCF", "SSSS")
# Number of modes in the range, and ranges of the first, the last, and the loud ones above it, Hz.
MODES, LOWEST, HIGHEST, LOUD = (8, 12), 45.0, 1400.0, 3500.0
# Relative standard deviations of a frequency from one test to the next, of constants about the data sheet,
# and of a gauged thickness and a weighed mass.
REPEATED, BELIEVED, GAUGED, WEIGHED = (1e-3, 4e-3), 0.05, 5e-3, 1e-3
DAMPING, DRIFT, NOISE, HUM = (0.003, 0.012), (2e-4, 2e-3), (3e-4, 5e-3), (3e-3, 3e-2)
AT_A_NODE, MOST_HITS, MOST_FALSE = 0.06, 6, 3
# A peak belongs to a source this close, in half widths, or else to the nearest within this fraction of f.
HALF_WIDTHS, NEAR = 1.0, 0.01
# A pairing of lower probability is reported as doubtful.
STATED = 0.9
# Shorter chains than the command's: enough for an interval of 95 % to a twentieth of its width.
SETTINGS = EnsembleSettings(walkers=40, round_steps=50, effective=400.0, r_hat=1.02, lengths=8.0)
SUMMED = "stated as doubtful"
# A constant is determined if its standard deviation is below this, %: a third of the data sheet's 25 %.
DETERMINED = 8.0
NO_MODE = -1


def drawn(rng: np.random.Generator) -> tuple[dict[str, Any], TruePlate, Array]:
    """A plate file without a list, the true plate, and its frequencies up to `LOUD`, Hz."""
    while True:
        reference, density = REFERENCES[str(rng.choice(list(REFERENCES)))]
        length = rng.uniform(180.0, 360.0)
        sizes = [round(length, 1), round(length * rng.uniform(0.55, 0.9), 1), round(rng.uniform(1.5, 4.0), 2)]
        stated: dict[str, Any] = {
            "name": "plate",
            "plate": {
                **dict(zip(("length_mm", "width_mm", "thickness_mm"), sizes, strict=True)),
                "mass_g": round(1e-6 * density * float(np.prod(sizes)), 2),
                "layup": str(rng.choice(LAYUPS)),
                "edges": str(rng.choice(EDGES)),
                "sd": {"thickness_mm": GAUGED * sizes[2]},
            },
            **material_tables(reference),
        }
        read = read_plate(stated)
        thickness = 1e-3 * sizes[2] * float(np.exp(GAUGED * rng.standard_normal()))
        mass = 1e-3 * stated["plate"]["mass_g"] * float(np.exp(WEIGHED * rng.standard_normal()))
        true = TruePlate(
            length=1e-3 * sizes[0],
            width=1e-3 * sizes[1],
            thickness=thickness,
            density=mass / (1e-6 * sizes[0] * sizes[1] * thickness),
            edges=stated["plate"]["edges"],
            angles_deg=tuple(read.plate.layup.angles_deg.tolist()),
            constants={n: v * float(np.exp(BELIEVED * rng.standard_normal())) for n, v in reference.items()},
        )
        f = natural_frequencies(true, 40)
        if f[0] > LOWEST and f[MODES[1]] < HIGHEST:
            return stated, true, f[f < LOUD]


def case(number: int, seed: int = REPORTED) -> Results:
    """One plate, its recordings, and the answer of `identify`."""
    rng = np.random.default_rng([seed, number])
    stated, true, f = drawn(rng)
    repeated = float(np.exp(rng.uniform(*np.log(REPEATED))))
    f = np.sort(f * (1.0 + repeated * rng.standard_normal(len(f))))
    n = int(rng.integers(MODES[0], MODES[1] + 1))
    low, high = round(0.7 * float(f[0])), round(float(f[n - 1] + rng.uniform(0.2, 0.8) * (f[n] - f[n - 1])))
    seen = np.flatnonzero(rng.random(n) >= AT_A_NODE)
    false = np.sort(rng.uniform(low, high, int(rng.integers(MOST_FALSE + 1))))
    n_hits = int(rng.integers(1, MOST_HITS + 1))
    faults = Faults(
        hum=float(np.exp(rng.uniform(*np.log(HUM)))) if rng.random() < 0.5 else 0.0,
        second_stroke=float(rng.uniform(0.02, 0.1)) if rng.random() < 0.4 else None,
        twice=1.0 / n_hits,
        drift=float(np.exp(rng.uniform(*np.log(DRIFT)))),
        noise=float(np.exp(rng.uniform(*np.log(NOISE)))),
        clipped=int(n_hits > 1 and rng.random() < 0.2),
    )
    known = bool(rng.random() < 0.5)
    sources, numbers = np.append(f[seen], false), [*(seen + 1).tolist(), *[NO_MODE] * len(false)]
    damping = rng.uniform(*DAMPING, len(sources))
    hits = recorded_hits(rng, sources, damping, n_hits, faults, above=tuple(f[n:].tolist()))
    with tempfile.TemporaryDirectory() as folder:
        for k, hit in enumerate(hits):
            wavfile.write(Path(folder) / f"{k}.wav", RATE, hit)
        measurement: dict[str, Any] = {"recordings": [folder], "range_hz": [float(low), float(high)]}
        if known:
            measurement["relative_std"] = float(f"{repeated:.2g}")
        start = time.perf_counter()
        specimen = read_plate({**stated, "measurement": measurement})
        reading = time.perf_counter() - start
        answer = cb.sample(specimen, seed=0, settings=SETTINGS)
    peaks = []
    for row in answer.frequencies:
        assert row.measured is not None
        peaks.append(
            {
                "hz": round(row.measured, 3),
                "true": _true(row.measured, sources, damping, numbers),
                "taken": row.number or NO_MODE,
                "probability": round(row.probability or 0.0, 4),
            }
        )
    constants = {
        user_name(name): {
            "true": true.constants[name],
            "low": constant.interval[0],
            "high": constant.interval[1],
            "inside": bool(constant.interval[0] <= true.constants[name] <= constant.interval[1]),
            "sd_percent": 100.0 * (constant.interval[1] - constant.interval[0]) / 3.92 / true.constants[name],
        }
        for name, constant in answer.constants.items()
        if constant.interval is not None
    }
    return {
        "case": number,
        "edges": true.edges,
        "layup": stated["plate"]["layup"],
        "repeated": repeated,
        "known": known,
        "hits": n_hits,
        "modes": n,
        "unseen": n - len(seen),
        "false": len(false),
        "faults": [name for name, value in _named(faults).items() if value],
        "status": answer.status,
        "peaks": peaks,
        "constants": constants,
        "reading_s": round(reading, 2),
        "seconds": round(answer.seconds, 1),
    }


def _named(faults: Faults) -> dict[str, bool]:
    return {
        "hum": faults.hum > 0.0,
        "second stroke": faults.second_stroke is not None,
        "clipped": faults.clipped > 0,
    }


def _true(f: float, sources: Array, damping: Array, numbers: list[int]) -> list[int]:
    """Modes that a peak may belong to, `NO_MODE` if it is no mode."""
    away = np.abs(sources - f)
    at = away < HALF_WIDTHS * damping * sources
    nearest = int(np.argmin(away))
    if away[nearest] < NEAR * f:
        at[nearest] = True
    return sorted({numbers[i] for i in np.flatnonzero(at)}) or [NO_MODE]


def outcome(found: Results) -> str:
    """Verdict: all paired peaks are of their modes, the wrong ones are reported as doubtful, or neither."""
    wrong = [p for p in found["peaks"] if p["taken"] != NO_MODE and p["taken"] not in p["true"]]
    if not wrong:
        return "right"
    return SUMMED if all(p["probability"] < STATED for p in wrong) else "wrong"


def results_of(cases: list[Results], quick: bool) -> Results:
    said = [outcome(c) for c in cases]
    inside = [[one["inside"] for one in c["constants"].values()] for c in cases]
    share = np.array([np.mean(one) for one in inside])
    reading = [c["reading_s"] for c in cases]
    every = [one for c in cases for one in c["constants"].values()]
    determined = [one["inside"] for one in every if one["sd_percent"] < DETERMINED]
    counts = {
        "plates": len(cases),
        **{name: said.count(name) for name in ("right", SUMMED, "wrong")},
        "constants": sum(map(len, inside)),
        "inside": sum(map(sum, inside)),
        "determined": len(determined),
        "determined_inside": sum(determined),
        "inside_se": float(np.std(share, ddof=1) / np.sqrt(len(cases))) if len(cases) > 1 else None,
        "reading_median_s": float(np.median(reading)),
        "reading_most_s": float(np.max(reading)),
        "peaks": sum(len(c["peaks"]) for c in cases),
        "paired": sum(p["taken"] != NO_MODE for c in cases for p in c["peaks"]),
        "paired_right": sum(
            p["taken"] != NO_MODE and p["taken"] in p["true"] for c in cases for p in c["peaks"]
        ),
        "modes": sum(c["modes"] - c["unseen"] for c in cases),
    }
    return {"quick": quick, "counts": counts, "cases": cases}


def run(quick: bool, minutes: float = float("inf")) -> Results:
    """Results of all plates, those not yet saved being computed; quick: one plate."""
    if quick:
        return results_of([case(0, DEVELOPMENT)], quick)
    return case_by_case(range(PLATES), case, lambda c: results_of(c, False), minutes=minutes, path=RESULTS)


def sections(results: Results) -> dict[str, str]:
    """Paragraph of a page on how many plates and constants are right."""
    c = results["counts"]
    error = (
        ""
        if c["inside_se"] is None
        else f" ({c['inside'] / c['constants']:.3f}, standard error {c['inside_se']:.3f})"
    )
    said = (
        f"{c['plates']} plates of independent elements were hit one to six times, with hum, second strokes, "
        "clipped files, unseen modes and up to three resonances from elsewhere. In "
        f"{c['right']} every peak was paired with its own mode; in {c[SUMMED] + c['wrong']} at least "
        f"one was not, {c['wrong']} of these with a stated probability of {STATED:g} or more. "
        f"{c['inside']} of {c['constants']} constants{error} lay in their 95 % intervals, and "
        f"{c['determined_inside']} of the {c['determined']} "
        f"that the peaks determine to {DETERMINED:g} % (the data sheet makes others too wide to fail). "
        f"Reading the recordings took {c['reading_median_s']:.1f} s in the median, "
        f"{c['reading_most_s']:.1f} s at most."
    )
    return {"plates": paragraph(said)}


def show(results: Results) -> None:
    rows = tuple((name, "" if value is None else f"{value:.4g}") for name, value in results["counts"].items())
    print(screen_text((Table("Fifty plates", (Heading(""), Heading("", number=True)), rows),), sys.stdout))


def said(found: Results) -> str:
    """A case in a line, with its wrong peaks and constants."""
    wrong = [p for p in found["peaks"] if p["taken"] != NO_MODE and p["taken"] not in p["true"]]
    missed = {n: c for n, c in found["constants"].items() if not c["inside"]}
    keys = ("case", "edges", "hits", "modes", "unseen", "false", "faults", "status", "reading_s", "seconds")
    return f"{outcome(found)} {[found[k] for k in keys]} {wrong} {missed}"


def main() -> None:
    others = partial(
        case_by_case,
        range(PLATES),
        partial(case, seed=DEVELOPMENT),
        partial(results_of, quick=True),
        say=lambda c: print(said(c), flush=True),
    )
    cases_main(__doc__, run, show, RESULTS, others)


if __name__ == "__main__":
    main()
