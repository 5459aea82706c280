"""Effects hidden in simulated lists: are they found, and is nothing found where nothing is hidden?

python studies/10_hidden_effects.py [--quick] [--workers N | --executor SPEC] [--per-cell N]
    [--only KIND ...] [--plates NAME ...] [--minutes M] [--store DIR]

Truths are finite elements on a mesh of their own with constants within 10 % of the reference, 0.2 % of noise
and rounding to 0.1 Hz; a few clean plates are solved on three-dimensional bricks by CalculiX instead, where
it is installed. The diagnosis has Ritz models (cpam_bayes/validation/diagnosis). Trials
are kept as they come, in rounds over all benches: a run that was stopped, or was given some minutes, goes on
where it was, and its results are those of the trials that there are.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import shutil
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor
from dataclasses import asdict
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from cpam_bayes.commands.options import add_executor_options
from cpam_bayes.diagnosis.hypotheses import P_NONE, P_OTHER, P_PAIR
from cpam_bayes.parallel import open_executor
from cpam_bayes.parallel import run as share_out
from cpam_bayes.report.tables import Column, Table, screen_text
from cpam_bayes.storage import cache_directory
from cpam_bayes.validation.diagnosis.trial_statistics import (
    confusion,
    figures,
    reliability,
    table,
    unreached,
)
from cpam_bayes.validation.diagnosis.trials import Trial, run_trial
from cpam_bayes.validation.diagnosis.truths import MESH, Bench, bench, variants_of_cause
from cpam_bayes.validation.draw_store import DrawStore
from cpam_bayes.validation.pages import listed, markdown_table, paragraph, with_error, write_sections
from cpam_bayes.validation.study_results import save_results

Results = dict[str, Any]

RESULTS = Path(__file__).parent / "results" / f"{Path(__file__).stem}.json"

KEYS = {
    "quick": "whether this is the small version",
    "noise": "relative standard deviation of a frequency",
    "resolution_hz": "rounding of the lists",
    "mesh": "elements of the truths along x and y",
    "benches": "plates with the modes in a list, and how many trials of each kind were done and planned",
    "figures": "one each: what was asked, the value, its standard error, the number of trials",
    "table": "by bench, cause and signal to noise: trials, shares that were right, probabilities",
    "confusion": "by bench and signal to noise: counts of leading causes by what was hidden",
    "reliability": "by set of trials: bins of the leading class's probability, and how often it was right",
    "not_reached": "causes that do not reach the signal to noise within their prior, or that are absorbed",
}

SEED = 0
NOISE, RESOLUTION_HZ = 0.002, 0.1
# Plate, frequencies in a list, and clean plates: 320 in all.
BENCHES = (("C1", 10, 90), ("A2", 10, 90), ("D3", 10, 70), ("C1", 6, 70))
RATIOS = (8.0, 4.0)
KINDS = ("clean", "bricks", "one", "lacks", "two", "outside", "prior")
# Trials of each cause and signal to noise.
PER_CELL = 5
# Trials of two causes, of causes that the dictionary lacks and from the priors, for one trial a cell.
TWO, OUTSIDE, PRIOR = 4, 6, 12
# Plates that bricks are solved of; a plate takes ten to fifty seconds.
BRICKS = {("A2", 10): 6, ("D3", 10): 4, ("C1", 10): 2}
# Signal to noise of each of two causes and of those outside the dictionary.
STRONG = 8.0
# Causes in turn that are two at once.
PAIRS = (
    ("sensor_mass", "warp"),
    ("taper_x", "membrane_stress"),
    ("skew", "sensor_mass"),
    ("warp", "outlier"),
    ("clamp_rotation", "taper_y"),
    ("clamp_translation", "warp"),
    ("misorientation", "sensor_mass"),
    ("viscoelastic", "taper_y"),
)
QUICK_BENCH = ("C1", 6, 1)
QUICK_TRIALS = (Trial("clean", seed=SEED), Trial("one", ("warp",), 8.0, seed=SEED))


def plan(own: Bench, per_cell: int, clean: int, bricks: int, kinds: Sequence[str]) -> list[list[Trial]]:
    """All trials of a bench in rounds, of random order: after each, all cells have as many."""
    named = dict.fromkeys(h.cause for h in own.singles if h.cause not in ("none", "other"))
    causes = tuple(c for c in named if variants_of_cause(own, c))
    pairs = [p for p in PAIRS if set(p) <= set(causes)]
    other_material = [h.cause for h in own.singles if h.other_material]
    rounds: list[list[Trial]] = []
    for i in range(per_cell):
        found: list[Trial] = []
        if "one" in kinds:
            for ratio in RATIOS:
                # what is no shift has no ratio
                own_causes = causes if ratio == RATIOS[0] else [c for c in causes if c != "mode_identity"]
                found += [Trial("one", (c,), ratio, i, seed=SEED) for c in own_causes]
            found += [Trial("one", (c,), 0.0, i, seed=SEED) for c in other_material]
        if "lacks" in kinds:
            found.append(Trial("one", (causes[i % len(causes)],), STRONG, i, lacks=True, seed=SEED))
        if "two" in kinds and pairs:
            at = range(TWO * i, TWO * (i + 1))
            found += [Trial("two", pairs[k % len(pairs)], STRONG, k // len(pairs), seed=SEED) for k in at]
        if "outside" in kinds:
            of = [causes[(OUTSIDE * i + k) % len(causes)] for k in range(OUTSIDE)]
            found += [Trial("outside", (c,), STRONG, i, seed=SEED) for c in of]
        if "prior" in kinds:
            found += [Trial("prior", number=PRIOR * i + k, seed=SEED) for k in range(PRIOR)]
        if "clean" in kinds:
            found += [Trial("clean", number=k, seed=SEED) for k in _share(clean, i, per_cell)]
        if "bricks" in kinds and shutil.which("ccx"):
            found += [Trial("bricks", number=k, seed=SEED) for k in _share(bricks, i, per_cell)]
        order = np.random.default_rng([SEED, i]).permutation(len(found))
        rounds.append([found[k] for k in order])
    return rounds


def _share(total: int, i: int, rounds: int) -> range:
    """Numbers that belong to one of so many rounds."""
    return range(total * i // rounds, total * (i + 1) // rounds)


def run(
    quick: bool,
    executor: Executor | None = None,
    store: Path | None = None,
    *,
    per_cell: int = PER_CELL,
    kinds: Sequence[str] = KINDS,
    plates: Sequence[str] | None = None,
    minutes: float | None = None,
    keep: Callable[[Results], None] = lambda results: None,
) -> Results:
    """Trials on all benches; quick: two on a thin plate with six modes.

    minutes : after which no further trials are begun. keep : told the results after each bench of a round.
    What a store has is counted whatever is asked for.
    """
    end = None if minutes is None else time.monotonic() + 60.0 * minutes
    records: dict[str, list[Results]] = {}
    planned: dict[str, list[list[Trial]]] = {}
    benches: dict[str, Bench] = {}
    for plate, modes, clean in (QUICK_BENCH,) if quick else BENCHES:
        name = f"{plate}, {modes} modes"
        planned[name] = []
        if plates is None or plate in plates:
            own = benches[name] = bench(plate, modes, noise=NOISE, resolution=RESOLUTION_HZ)
            bricks = BRICKS.get((plate, modes), 0)
            planned[name] = [list(QUICK_TRIALS)] if quick else plan(own, per_cell, clean, bricks, kinds)
        records[name] = _trials(name, None, [], executor, store, end)

    def results() -> Results:
        rows = [
            _progress(name, records[name], [t for trials in planned[name] for t in trials])
            for name in records
        ]
        return {
            "quick": quick,
            "noise": NOISE,
            "resolution_hz": RESOLUTION_HZ,
            "mesh": list(MESH),
            "benches": rows,
            "figures": figures(records),
            "table": table(records),
            "confusion": confusion(records),
            "reliability": reliability(records),
            "not_reached": unreached(records),
        }

    for i in range(max(len(rounds) for rounds in planned.values())):
        for name, rounds in planned.items():
            if i < len(rounds):
                records[name] = _trials(name, benches[name], rounds[i], executor, store, end, records[name])
                keep(results())
    return results()


def _trials(
    name: str,
    own: Bench | None,
    trials: list[Trial],
    executor: Executor | None,
    store: Path | None,
    end: float | None,
    before: Sequence[Results] = (),
) -> list[Results]:
    """Records of the trials that are done, those before and those of the store among them."""
    kept = None
    if store is not None:
        key = hashlib.sha256(
            json.dumps([name, NOISE, RESOLUTION_HZ, MESH, SEED, P_NONE, P_OTHER, P_PAIR]).encode()
        ).hexdigest()[:32]
        kept = DrawStore.open(store / f"{name.replace(', ', '_').replace(' ', '_')}.jsonl", key)
    done = {json.dumps(r["trial"]): r for r in before}
    if kept is not None:
        done |= {json.dumps(r["trial"]): r for r in kept.records}
    missing = [t for t in trials if _name(t) not in done]

    def take(index: int, record: Results) -> None:
        del index
        if kept is not None:
            kept.append(record)
        done[json.dumps(record["trial"])] = record
        if store is not None:
            print(f"\r{name}: {len(done)} done", end="", file=sys.stderr, flush=True)

    # a piece at a time, so that minutes can end it
    piece = 8 if end is not None else max(len(missing), 1)
    for start in range(0, len(missing), piece):
        if end is not None and time.monotonic() > end:
            break
        share_out(run_trial, own, missing[start : start + piece], executor, batch_size=1, on_result=take)
    if store is not None and missing:
        print(file=sys.stderr)
    return sorted(done.values(), key=lambda r: json.dumps(r["trial"]))


def _name(trial: Trial) -> str:
    return json.dumps(json.loads(json.dumps(asdict(trial))))


def _progress(name: str, records: list[Results], trials: list[Trial]) -> Results:
    done: dict[str, int] = {}
    for r in records:
        done[r["trial"]["kind"]] = done.get(r["trial"]["kind"], 0) + 1
    planned: dict[str, int] = {}
    for t in trials:
        planned[t.kind] = planned.get(t.kind, 0) + 1
    return {"name": name, "done": done, "planned": planned}


def show(results: Results) -> None:
    """Print the results as tables."""
    lines = tuple(
        (
            f["name"],
            f["asked"],
            "-" if f["value"] is None else f"{f['value']:.3f}({f['error']:.3f})",
            str(f["n"]),
        )
        for f in results["figures"]
    )
    head = (Column("figure"), Column("asked"), Column("reached", True), Column("trials", True))
    found = [Table("Figures reached, standard error in brackets", head, lines)]
    cells = tuple(
        (
            row["bench"],
            row["cause"],
            f"{row['ratio']:g}",
            str(row["n"]),
            f"{row['right']:.2f}",
            "-" if row["oracle"] is None else f"{row['oracle']:.2f}",
            f"{row['class_probability']:.2f}",
            f"{row['none']:.2f}",
            ", ".join(row["alike"]),
        )
        for row in results["table"]
    )
    titles = ("bench", "cause", "signal to noise", "trials", "class right", "oracle", "P(class)", "P(none)")
    columns = (*(Column(t, i > 1) for i, t in enumerate(titles)), Column("like it"))
    found.append(Table("Hidden causes; means over the trials of a cell", columns, cells))
    print(screen_text(tuple(found), sys.stdout))
    for row in results["not_reached"]:
        print(f"{row['bench']}: {row['cause']} does not reach {row['ratio']:g}: {row['why']}")


# Sections of docs/hidden_effects.md


def sections(results: Results) -> dict[str, str]:
    """What docs/hidden_effects.md says of the trials."""
    trials = max(row["n"] for row in results["figures"])
    on = listed([bench["name"].replace(", ", " with ") for bench in results["benches"]])
    return {
        "trials": paragraph(
            f"{trials} trials on {on}; causes that do not reach the ratio within their prior are left out "
            "(the study lists them):"
        ),
        "figures": markdown_table(
            ("", "asked", "reached (standard error)", "trials"), map(_figure, results["figures"])
        ),
        "oracle": "\n".join(_beside_oracle(results["figures"])),
    }


def _beside_oracle(rows: Sequence[Results]) -> Iterator[str]:
    """Whether the oracle finds more, which knows the model of the truth."""
    for row, oracle in pairwise(rows):
        if "oracle" in oracle["name"]:
            more = oracle["value"] - row["value"] > 2.0 * row["error"]
            said = "finds more on" if more else "finds no more, within two standard errors, on"
            yield f"- {row['name']}: the oracle {said} the same lists."


def _figure(row: Results) -> tuple[str, ...]:
    name = row["name"].strip().replace("slips of the list", "transcription errors")
    reached = with_error(row["value"], row["error"])
    if name.startswith("expected calibration error"):
        reached = f"{row['value']:.3f}, by chance alone {row['error']:.3f}"
    if name.startswith("processor seconds"):
        reached = f"{row['value']:.1f}"
    return name, row["asked"], reached, str(row["n"])


def main() -> None:
    """Run the study, print its tables and save the results."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="the small version; nothing is saved")
    add_executor_options(parser)
    parser.add_argument("--per-cell", type=int, default=PER_CELL, metavar="N", help="trials of each cell")
    parser.add_argument(
        "--only", nargs="+", choices=KINDS, default=KINDS, metavar="KIND", help=", ".join(KINDS)
    )
    parser.add_argument("--plates", nargs="+", metavar="NAME", help="plates to work on; others as stored")
    parser.add_argument("--minutes", type=float, metavar="M", help="begin no further trials after M minutes")
    parser.add_argument(
        "--store",
        type=Path,
        metavar="DIR",
        default=cache_directory() / "hidden_effects",
        help="where trials are kept, a file a bench (default: in the package's cache)",
    )
    args = parser.parse_args()

    def keep(results: Results) -> None:
        if not args.quick:
            save_results(RESULTS, results)
            write_sections(Path(__file__).parents[1], RESULTS.stem, sections(results))

    with open_executor(args.executor, args.workers) as executor:
        results = run(
            args.quick,
            executor,
            None if args.quick else args.store,
            per_cell=args.per_cell,
            kinds=args.only,
            plates=args.plates,
            minutes=args.minutes,
            keep=keep,
        )
    show(results)
    keep(results)


if __name__ == "__main__":
    main()
