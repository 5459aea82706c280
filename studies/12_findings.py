"""What the diagnosis finds on the paper's plates and on five plates of spruce, alone and jointly.

python studies/12_findings.py [--quick] [--only C1 ...] [--page]

Every group is diagnosed, saved, and written to docs/findings.md; --page writes the page from what is saved.
"""

from __future__ import annotations

import csv
import sys
import time
import tomllib
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import cpam_bayes as cb
from cpam_bayes.formatting import significant
from cpam_bayes.plate import Specimen
from validation.reporting import (
    listed,
    paragraph,
    save_results,
    saved_results,
    study_parser,
    with_saved,
    write_sections,
)

Results = dict[str, Any]

HERE = Path(__file__).parent
RESULTS = HERE / "results" / f"{Path(__file__).stem}.json"
SPRUCE = HERE / "data" / "spruce_plates.csv"

KEYS = {
    "quick": "whether this is the small version",
    "groups": "one a group of plates: the answer, the claims at other scales of the priors, ten causes, "
    "the fits, the averaged constants, the gain, the sizes that would have shown, seconds",
}

ALONE = ("D&G", "A1", "A2", "B1", "B2", "C1", "C2", "C3", "C4", "D1", "D2", "D3", "D4")
TOGETHER = (("A1", "A2"), ("B1", "B2"), ("C1", "C2"), ("C3", "C4"), ("D1", "D2"), ("D3", "D4"))
_LISTED = 10
CONSTANTS = ("E1_GPa", "E2_GPa", "G12_GPa")
# Sections of the plate file that all plates of spruce share.
SPRUCE_SECTIONS = tomllib.loads("""
[material]
name = "spruce"
isotropic = false
E1_GPa = 10.9
E2_GPa = 0.85
nu12 = 0.372
G12_GPa = 0.70
G13_GPa = 0.665
G23_GPa = 0.033
[material.sd]
E1_GPa = 1.6
E2_GPa = 0.25
nu12 = 0.08
G12_GPa = 0.2
[unknowns]
E1_GPa = [5.0, 20.0]
E2_GPa = [0.2, 2.0]
nu12 = [0.1, 0.7]
G12_GPa = [0.2, 2.0]
[environment]
air_density_kg_m3 = 1.2
""")


def run(
    quick: bool = False,
    only: Sequence[str] = (),
    keep: Callable[[Results], None] = lambda results: None,
) -> Results:
    """Diagnoses of all groups; quick: one plate.

    only : names of groups, plates joined by ``+``. keep : called with the results after each group.
    """
    wood = spruce()
    groups = [g for g in groups_of(wood) if not only or "+".join(g) in only]
    if quick:
        groups = groups[:1]
    rows = []
    for group in groups:
        start = time.process_time()
        document = cb.diagnose(*(wood.get(name, name) for name in group), next_test="never").to_dict()
        rows.append(row_of(document, time.process_time() - start))
        if not quick:
            print(f"{line_of(rows[-1])}, {rows[-1]['seconds']:.0f} s", file=sys.stderr, flush=True)
            keep({"quick": quick, "groups": rows})
    return {"quick": quick, "groups": rows}


def groups_of(wood: Iterable[str]) -> list[tuple[str, ...]]:
    """All groups of plates: each plate alone, then those of one material together."""
    alone = [(name,) for name in (*ALONE, *wood)]
    return [*alone, *TOGETHER]


def row_of(document: Mapping[str, Any], seconds: float) -> Results:
    """The parts of an answer that are saved.

    document : the JSON document of `diagnose`
    """
    kept = ("claim", "causes", "probability", "sentence", "claim_stands", "claims_by_prior_scales")
    extended = document["extended"]
    return {
        "plates": [plate["plate"] for plate in document["plates"]],
        **{key: document[key] for key in kept},
        "hypotheses": [_cause(h) for h in document["hypotheses"][:_LISTED]],
        "not_tested": document["not_tested"],
        "baseline": _fit(document["baseline"]),
        "extended": None if extended is None else _fit(extended),
        "averaged": _constants(document["averaged"]),
        "gain": document["gain"],
        "detectable": document["detectable"],
        "seconds": seconds,
    }


def _cause(hypothesis: Mapping[str, Any]) -> Results:
    kept = ("cause", "variant", "plates", "probability", "probability_range", "log_bayes_factor")
    return {key: hypothesis[key] for key in (*kept, "parameters", "indistinguishable_from")}


def _fit(fit: Mapping[str, Any]) -> Results:
    return {
        "constants": _constants(fit["constants"]),
        "rms_as_stated_percent": fit["rms_as_stated_percent"],
        "predictive_p": fit["predictive_p"],
        "residual_percent": [f["residual_percent"] for f in fit["frequencies"]],
    }


def _constants(constants: Mapping[str, Mapping[str, float]]) -> Results:
    return {name: {key: v[key] for key in ("mean", "sd", "q025", "q975")} for name, v in constants.items()}


def spruce() -> dict[str, Specimen]:
    """The five plates of spruce.

    Priors of the constants: Sitka spruce of the Wood Handbook (FPL-GTR-282, Tables 5-1, 5-2 and 5-3: E_L 10 %
    above the static modulus, ratios E_R / E_L 0.078, G_LR / E_L 0.064, G_LT / E_L 0.061, G_RT / E_L 0.003,
    nu_LR 0.372), wide enough for tonewood.
    """
    with SPRUCE.open(encoding="utf-8") as file:
        rows = csv.DictReader(line for line in file if not line.startswith("#"))
        return {row["plate"]: cb.read_plate(_spruce_plate(row)) for row in rows}


def _spruce_plate(row: dict[str, str]) -> dict[str, Any]:
    """The plate file of a row as a dictionary."""
    widths = [float(w) for w in row["widths_mm"].split(";")]
    measured = {key: float(row[key]) for key in ("length_mm", "thickness_mm", "mass_g")}
    return {
        **SPRUCE_SECTIONS,
        "name": row["plate"],
        "plate": {
            **measured,
            "width_mm": round(sum(widths) / len(widths), 2),
            "layup": "[0]",
            "edges": "FFFF",
        },
        "measurement": {
            "frequencies_hz": [float(f) for f in row["frequencies_hz"].split(";")],
            "resolution_hz": 0.5,
            "complete": False,
        },
    }


def line_of(row: Results) -> str:
    """Answer for one group in a line."""
    return f"{' + '.join(row['plates'])}: {row['claim']} {' '.join(row['causes'])} {row['probability']:.2f}"


def sections(results: Results) -> dict[str, str]:
    """Section of docs/findings.md on the plates."""
    rows = {tuple(row["plates"]): row for row in results["groups"]}
    wood = tuple(spruce())
    alone = [rows[name,] for name in ALONE if (name,) in rows]
    together = [rows[group] for group in TOGETHER if group in rows]
    of_wood = [rows[name,] for name in wood if (name,) in rows]
    parts = [
        (alone, [_HEAD, *_answers(alone), ""]),
        (together, [_TOGETHER, *_answers(together, ()), ""]),
        (of_wood, [_WOOD, *_answers(of_wood), "", _published(of_wood), ""]),
    ]
    return {"plates": "\n".join(line for of, lines in parts if of for line in lines)}


def _answers(rows: Sequence[Results], names: Sequence[str] = CONSTANTS) -> Iterable[str]:
    """Table with one group per line: the answer as shown on the screen, and intervals of constants."""
    yield f"| {' | '.join(('plates', 'answer', 'misfit %, plain, extended', *names))} |"
    yield "|" + "---|" * (3 + len(names))
    for row in rows:
        # an error of unknown form corrects nothing
        after = None if row["claim"] == "other" else row["extended"]
        fits = (row["baseline"], *([after] if after else []))
        misfit = ", ".join(f"{fit['rms_as_stated_percent']:.2f}" for fit in fits)
        intervals = (_value(row["averaged"].get(name)) for name in names)
        yield f"| {' | '.join((' + '.join(row['plates']), row['sentence'], misfit, *intervals))} |"


def _value(constant: Mapping[str, float] | None) -> str:
    if constant is None:
        return ""
    return "\u2013".join(significant(constant[end], 3) for end in ("q025", "q975"))


def _published(rows: Sequence[Results]) -> str:
    """Sentence on how many published constants lie in the intervals, and which do not."""
    with SPRUCE.open(encoding="utf-8") as file:
        table = csv.DictReader(line for line in file if not line.startswith("#"))
        published = {row["plate"]: row["published_Ex_Ey_Gxy_nu"].split(";") for row in table}
    outside, of = list[str](), 0
    for row in rows:
        plate = row["plates"][0]
        for name, value in zip(_PUBLISHED, published[plate], strict=True):
            within, of = row["averaged"][name], of + 1
            if not within["q025"] <= float(value) <= within["q975"]:
                outside.append(f"{name.partition('_')[0]} of {plate} ({value})")
    missed = f", but not {listed(outside)}" if outside else ""
    said = f"Of {of} published constants, nu12 included, {of - len(outside)} lie in their 95 % intervals"
    return paragraph(f"{said}{missed}.")


_PUBLISHED = ("E1_GPa", "E2_GPa", "G12_GPa", "nu12")

_HEAD = """95 % intervals are averaged over all sets of causes.
"""
_TOGETHER = """## Plates of one material together

Plates of one material share their constants, with a scatter of 2 % from plate to plate.
"""
_WOOD = """## Five plates of spruce

Tonewood plates of Badiane et al. (J. Acoust. Soc. Am., 2023), free, with one accelerometer, in air; lists may
lack modes. Priors: Sitka spruce of the Wood Handbook. The plates are not quite rectangles: 1L narrows from
217 to 199 mm at one end, which no cause describes, so its claim is probably wrong.
"""


def main() -> None:
    """Diagnose, save the results and write the page."""
    parser = study_parser(__doc__)
    parser.add_argument("--only", nargs="+", default=(), help="groups, plates of one joined by +")
    parser.add_argument("--page", action="store_true", help="write the page from what is saved, run nothing")
    args = parser.parse_args()
    order = groups_of(spruce())

    def keep(results: Results) -> None:
        save_results(RESULTS, with_saved(results, RESULTS, order, lambda group: tuple(group["plates"])))

    if not args.page:
        for row in run(args.quick, args.only, keep)["groups"]:
            print(line_of(row))
    if not args.quick:
        write_sections(HERE.parent, RESULTS.stem, sections(saved_results(RESULTS)))


if __name__ == "__main__":
    main()
