"""Does what misled earlier versions still mislead the diagnosis, and are good plates of bricks left alone?

python studies/30_patterns.py [--quick] [--minutes M] [--development]

Nine patterns, each on twenty plates of independent elements drawn anew: two accelerometers, four pads, a
missing ply, tape along an edge, turned plies, a smooth error of 1 %, two tapers, a missing corner, a mass
beside a misread frequency. Twenty plates of CalculiX bricks without an error go through ten combinations of
edges; they are left out if its program `ccx` is missing. The seed was drawn after the engine was finished.

`--development` draws other lists, prints each and saves nothing.
"""

from __future__ import annotations

import shutil
import sys
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.forward_model.calculix.run import solve_modes
from cpam_bayes.render.report import Heading, Table
from cpam_bayes.render.terminal import screen_text
from validation import brick_lists
from validation.claims import fresh, scoring
from validation.independent import drawn
from validation.independent.lists import FURTHER, NominalPlate, Truth, written
from validation.independent.true_plate import TruePlate
from validation.reporting import Results, case_by_case, cases_main, markdown_table, paragraph

Array = NDArray[np.float64]
RESULTS = Path(__file__).parent / "results" / f"{Path(__file__).stem}.json"

KEYS = {
    "quick": "whether this is the small version",
    "patterns": "by pattern: lists, claims by how right they are, constants in their 95 % intervals, seconds",
    "cases": "one a list: its score, which constants are inside, seconds",
}

# Seeds of the lists that are reported, and of those for development.
REPORTED, DEVELOPMENT = 126230209, 3000
EACH = 20
# Name of the benchmark's lists -> what is hidden.
PATTERNS = {
    "former-two-accelerometers": "two accelerometers",
    "former-four-pads": "four pads",
    "former-a-ply-missing": "a ply missing",
    "former-tape": "tape along an edge",
    "former-plies-turned": "plies turned by 7 to 11 degrees",
    "former-smooth": "smooth error of 1 %",
    "former-both-tapers": "tapered along both sides",
    "former-corner": "a corner missing",
    "former-mass-and-misread": "a mass and a misread frequency",
}
CLEAN = "nothing, on bricks"
KINDS = (*PATTERNS.values(), CLEAN)
EDGES = ("FFFF", "CFFF", "SFFF", "CFCF", "SFSF", "CCFF", "CSFF", "SSSS", "CSCS", "CCCC")
# Elements in the plane of the two meshes whose frequencies are extrapolated.
MESHES = (60, 120)
OPEN = (scoring.OTHER, scoring.UNDECIDED)


def good_bricks(number: int, seed: int) -> Results:
    """A list of a plate of bricks on which nothing is wrong."""
    rng = np.random.default_rng([seed, number])
    nominal = drawn.plate(rng, lambda true: True)
    held = replace(nominal.plate, edges=EDGES[number % len(EDGES)], bias=())
    nominal = replace(nominal, plate=held, weighed=False)
    true = nominal.drawn(rng)
    truth = Truth(
        kind="bricks",
        plate=nominal.name,
        causes=(),
        accepted=(),
        sizes={},
        aux={},
        ratio=None,
        constants={n: float(true.constants[n]) for n in nominal.constants},
        true_hz=(),
        stated=drawn.is_stated(rng),
        complete=True,
        known=nominal.known,
        noise=nominal.noise,
    )
    text, truth = written(nominal, brick_frequencies(nominal, true), truth, rng)
    return {"id": f"bricks-{held.edges}-{number}", "file": text, "truth": asdict(truth)}


def brick_frequencies(nominal: NominalPlate, true: TruePlate) -> Array:
    """Frequencies of the list and FURTHER modes, extrapolated from two meshes of bricks, Hz."""
    specimen, constants = brick_lists.specimen_of(nominal, true)
    n = nominal.n_modes + FURTHER
    rough, fine = (solve_modes(specimen, constants, n, in_plane=m).frequencies for m in MESHES)
    return np.asarray(fine - (rough - fine) / 3.0)


def case(number: int, seed: int = REPORTED) -> Results:
    """A list and its score; lists of all patterns take turns."""
    k, which = divmod(number, len(KINDS))
    names = list(PATTERNS)
    entry = fresh.another(names[which], k, seed) if which < len(names) else good_bricks(k, seed)
    return {"case": number, "pattern": KINDS[which], **fresh.judged(entry)}


def results_of(cases: list[Results], quick: bool) -> Results:
    made = [c for c in cases if "unreachable" not in c]
    rows = [_row(kind, [c for c in made if c["pattern"] == kind]) for kind in KINDS]
    return {"quick": quick, "patterns": [row for row in rows if row["lists"]], "cases": cases}


def _row(kind: str, those: list[Results]) -> Results:
    held = [all(c["inside"].values()) for c in those]
    fits = [c["right"] or c["category"] in OPEN for c in those]
    return {
        "pattern": kind,
        "lists": len(those),
        "right": sum(c["right"] for c in those),
        "open": sum(c["category"] in OPEN and not c["right"] for c in those),
        "missed": sum(c["category"] == scoring.MISSED for c in those),
        "wrong": sum(c["category"] == scoring.WRONG for c in those),
        "right_or_open_and_held": sum(a and b for a, b in zip(fits, held, strict=True)),
        "inside": sum(sum(c["inside"].values()) for c in those),
        "inside_plain": sum(sum(c["inside_plain"].values()) for c in those),
        "constants": sum(len(c["inside"]) for c in those),
        "seconds": float(np.median([c["seconds"] for c in those])) if those else None,
    }


def numbers() -> list[int]:
    """Numbers of the lists; without `ccx` those of elements only."""
    every = range(EACH * len(KINDS))
    return [n for n in every if shutil.which("ccx") or KINDS[n % len(KINDS)] != CLEAN]


def run(quick: bool, minutes: float = float("inf")) -> Results:
    """Results of all lists, those not yet saved being computed; quick: one list."""
    if quick:
        return results_of([case(KINDS.index("a corner missing"), DEVELOPMENT)], quick)
    return case_by_case(numbers(), case, lambda c: results_of(c, False), minutes=minutes, path=RESULTS)


HEAD = (
    "what is hidden",
    "right/open/missed/wrong",
    "right or open, all constants held",
    "constants held",
    "by the plain model",
)


def _rows(results: Results) -> list[tuple[str, ...]]:
    return [
        (
            row["pattern"],
            "/".join(str(row[key]) for key in ("right", "open", "missed", "wrong")),
            f"{row['right_or_open_and_held']}/{row['lists']}",
            *(f"{row[key]}/{row['constants']}" for key in ("inside", "inside_plain")),
        )
        for row in results["patterns"]
    ]


def sections(results: Results) -> dict[str, str]:
    """The counts as a table of a page, and what they add up to."""
    rows = [r for r in results["patterns"] if r["pattern"] != CLEAN]
    total = {key: sum(r[key] for r in rows) for key in rows[0] if key not in ("pattern", "seconds")}
    answered = sum(r["lists"] for r in results["patterns"])
    said = (
        f"{answered} of {EACH * len(KINDS)} lists answered. Errors: right or open "
        f"{total['right'] + total['open']} of {total['lists']}, {total['right_or_open_and_held']} with all "
        "constants inside; "
        f"wrong {total['wrong']}; "
        f"{total['inside'] / total['constants']:.3f} of {total['constants']} constants lie in their 95 % "
        f"intervals, {total['inside_plain'] / total['constants']:.3f} with the plain model."
    )
    return {"patterns": f"{paragraph(said)}\n\n{markdown_table(HEAD, _rows(results))}"}


def show(results: Results) -> None:
    columns = (Heading(HEAD[0]), *(Heading(text, number=True) for text in HEAD[1:]))
    print(screen_text((Table("Patterns", columns, tuple(_rows(results))),), sys.stdout))


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
