"""What the diagnosis finds on the paper's plates and on five plates of spruce, alone and jointly.

python studies/12_findings.py [--quick] [--only C1 ...]
"""

from __future__ import annotations

import argparse
import csv
import sys
import time
import tomllib
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import cpam_bayes as cb
from cpam_bayes.diagnosis.diagnose import Diagnosis
from cpam_bayes.diagnosis.fit import Fit
from cpam_bayes.plate import Specimen, to_user, user_name
from cpam_bayes.report.tables import Column, Table, screen_text
from cpam_bayes.validation.study_results import save_results, with_saved

HERE = Path(__file__).parent
RESULTS = HERE / "results" / f"{Path(__file__).stem}.json"
SPRUCE = HERE / "data" / "spruce_plates.csv"

KEYS = {
    "quick": "whether this is the small version",
    "groups": "one a group of plates: plates, claim, causes, probability, hypotheses (the first ten), "
    "baseline, extended, gain, seconds",
}

ALONE = ("D&G", "A1", "A2", "B1", "B2", "C1", "C2", "C3", "C4", "D1", "D2", "D3", "D4")
TOGETHER = (("A1", "A2"), ("B1", "B2"), ("C1", "C2"), ("C3", "C4"), ("D1", "D2"), ("D3", "D4"))
_LISTED = 10
# Of a plate file, the same for all plates of spruce.
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
    keep: Callable[[dict[str, Any]], None] = lambda results: None,
) -> dict[str, Any]:
    """Diagnose every group; quick: one plate.

    only : names of groups, plates joined by ``+``. keep : told the results after each group.
    """
    wood = spruce()
    groups = [g for g in groups_of(wood) if not only or "+".join(g) in only]
    if quick:
        groups = groups[:1]
    found = []
    for group in groups:
        start = time.process_time()
        plates = [wood.get(name, name) for name in group]
        diagnosis = cb.diagnose(*plates, next_test="never").diagnosis
        found.append({**told(diagnosis), "seconds": time.process_time() - start})
        if not quick:
            print(
                f"{' + '.join(group)}: {diagnosis.claim.kind} {found[-1]['seconds']:.0f} s", file=sys.stderr
            )
            keep({"quick": quick, "groups": found})
    return {"quick": quick, "groups": found}


def groups_of(wood: Iterable[str]) -> list[tuple[str, ...]]:
    """All groups of plates: each alone, then those of one material together."""
    alone = [(name,) for name in (*ALONE, *wood)]
    return [*alone, *TOGETHER, ("1L", "2L"), ("3L", "4L")]


def told(diagnosis: Diagnosis) -> dict[str, Any]:
    """A diagnosis as plain data, in the units of the plate file."""
    fit = {"baseline": _fit(diagnosis.baseline)}
    fit["extended"] = None if diagnosis.extended is None else _fit(diagnosis.extended)
    gain = diagnosis.gain
    return {
        "plates": [case.name for case in diagnosis.cases],
        "claim": diagnosis.claim.kind,
        "causes": list(diagnosis.claim.causes),
        "probability": diagnosis.claim.probability,
        "hypotheses": [
            {
                "cause": c.name,
                "variant": c.variant,
                "plates": list(c.plates),
                "probability": c.probability,
                "log_bayes_factor": c.log_bayes_factor,
                "parameters": {name: list(value) for name, value in c.parameters.items()},
                "indistinguishable_from": list(c.indistinguishable_from),
                "visible": c.visible,
            }
            for c in diagnosis.causes[:_LISTED]
        ],
        "not_tested": list(diagnosis.weighed.not_tested),
        **fit,
        "gain": None
        if gain is None
        else {
            "log_bayes_factor": gain.log_bayes_factor,
            "held_out": gain.held_out_difference,
            "held_out_se": gain.held_out_se,
            "stable": gain.stable,
        },
    }


def _fit(fit: Fit) -> dict[str, Any]:
    return {
        "constants": {
            user_name(name): [to_user(name, v) for v in values]
            for name, values in fit.constants.items()
            if not name.startswith("scatter")
        },
        "rms_percent": 100.0 * fit.rms,
        "p_value": fit.p_value,
        "log_evidence": fit.log_evidence,
        "standardised": [float(r) for r in fit.standardised],
        "residual_percent": [float(100.0 * r) for r in fit.measured / fit.predicted - 1.0],
    }


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
    """The sections of a plate file."""
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


def show(results: dict[str, Any]) -> None:
    """Print the claims, one line a group."""
    rows = []
    for group in results["groups"]:
        first = next(h for h in group["hypotheses"])
        extended = group["extended"]
        rows.append(
            (
                " + ".join(group["plates"]),
                group["claim"],
                " ".join(group["causes"]),
                f"{group['probability']:.2f}",
                f"{first['cause']} {first['variant']}".strip(),
                f"{first['log_bayes_factor']:.1f}",
                f"{group['baseline']['rms_percent']:.2f}",
                "" if extended is None else f"{extended['rms_percent']:.2f}",
                f"{group['baseline']['p_value']:.2f}",
            )
        )
    columns = tuple(
        Column(name)
        for name in ("plates", "claim", "causes", "P", "leading", "log BF", "rms %", "after %", "p")
    )
    print(screen_text((Table("Diagnoses", columns, tuple(rows)),), sys.stdout))


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="the small version; nothing is saved")
    parser.add_argument("--only", nargs="+", default=(), help="groups, plates of one joined by +")
    args = parser.parse_args()
    order = groups_of(spruce())

    def keep(results: dict[str, Any]) -> None:
        save_results(RESULTS, with_saved(results, RESULTS, order, lambda group: tuple(group["plates"])))

    show(run(args.quick, args.only, keep))


if __name__ == "__main__":
    main()
