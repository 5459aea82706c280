"""Are the claims of the diagnosis right? Truths from independent elements, off every grid.

python studies/15_claims.py [--make SET ...] [--answer SET ...] [--references SET ...]
    [--engine NAME=TREE] [--workers N] [--minutes M] [--only TEXT] [--limit N] [--quick]

The lists are files with their truths, one JSON line each in studies/data/claims: "id", "file" (a plate
file as text) and "truth". --make writes a set anew, --answer asks the diagnosis for what is not answered
yet, --references adds what users do instead. Without these the answers that there are
become results, and the section of docs/hidden_effects.md. --engine NAME=TREE asks
another version of the package for its answers. Another method is scored in the same way: write one JSON
line a list with "id" and the keys of `cpam-bayes diagnose --json` into
studies/data/claims/answers/SET_NAME.jsonl.

Tuning looked at the set "tuning" alone; "final" has other plates and seeds. "rows" are twenty plates each of
the failures that earlier versions were known for.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cpam_bayes as cb
from validation.claims import answering, references, scoring
from validation.independent import sets
from validation.independent.lists import NOISE
from validation.reporting import save_results, write_sections

Results = dict[str, Any]

HERE = Path(__file__).parent
RESULTS = HERE / "results" / f"{Path(__file__).stem}.json"
DATA = HERE / "data" / "claims"

KEYS = {
    "quick": "whether this is the small version",
    "noise": "relative standard deviation of a frequency",
    "plates": "by set: name, material, layup, edges, modes in a list, whether the file has [material.sd]",
    "lists": "by set: how many there are",
    "unreachable": "by set: lists that could not be made, and why",
    "sets": "by set, of the diagnosis and of others on the same lists: figures, confusion of claims and more",
}

THIS = "diagnosis"
# What is kept of other methods.
BRIEF = ("lists", "by_kind", "figures")
NAMES = {m: m.replace("_", " ") for m in references.METHODS}
QUICK_LIST = "taper_x-32-0"


def data_path(name: str) -> Path:
    """The lists of a set."""
    return DATA / f"{name}.jsonl"


def answers_path(name: str, engine: str) -> Path:
    """The answers of an engine or a method to a set."""
    return DATA / "answers" / f"{name}_{engine}.jsonl"


def run(quick: bool) -> Results:
    """Scores of all answers that there are; quick: one list of the tuning set, made and answered here."""
    if quick:
        own = sets.SETS["tuning"]
        entries = [sets.make(own, plan) for plan in sets.planned(own) if plan.name == QUICK_LIST]
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "answers.jsonl"
            answering.answer(entries, path, _diagnosed)
            answers = {THIS: answering.answered(path)}
        return _results(True, {"tuning": (entries, answers)})
    found = {}
    for name in sets.SETS:
        entries = _lines(data_path(name)) if data_path(name).exists() else []
        engines = {
            p.stem.removeprefix(f"{name}_"): answering.answered(p)
            for p in sorted((DATA / "answers").glob(f"{name}_*.jsonl"))
        }
        found[name] = (entries, engines)
    return _results(False, found)


def _results(quick: bool, found: dict[str, tuple[list[Results], dict[str, dict[str, Results]]]]) -> Results:
    said: Results = {}
    for name, (entries, engines) in found.items():
        scores = {engine: scoring.scored(entries, answers) for engine, answers in engines.items()}
        mine = scores.get(THIS, [])
        said[name] = {THIS: scoring.summary(mine)} if mine else {}
        for engine, records in scores.items():
            # beside another engine or method: the lists that both answered
            theirs = {r["id"] for r in records}
            both = {r["id"] for r in mine} & theirs if mine else theirs
            if engine != THIS and both:
                own = scoring.summary([r for r in records if r["id"] in both])
                said[name][engine] = {k: own[k] for k in BRIEF}
    return {
        "quick": quick,
        "noise": NOISE,
        "plates": {
            name: [
                {
                    "name": p.name,
                    "material": p.material,
                    "layup": p.layup,
                    "edges": p.plate.edges,
                    "modes": p.n_modes,
                    "material_sd": p.known,
                }
                for p in own.plates
            ]
            for name, own in sets.SETS.items()
        },
        "lists": {name: sum("file" in r for r in entries) for name, (entries, _) in found.items()},
        "unreachable": {
            name: [{"id": r["id"], "why": r["unreachable"]} for r in entries if "unreachable" in r]
            for name, (entries, _) in found.items()
        },
        "sets": said,
    }


def make(name: str) -> None:
    """Write a set of lists."""
    data_path(name).parent.mkdir(parents=True, exist_ok=True)
    with data_path(name).open("w", encoding="utf-8") as file:
        for record in sets.made(sets.SETS[name]):
            file.write(sets.line_of(record))
            file.flush()


def answer(
    name: str, engine: str, tree: Path, workers: int, minutes: float | None, only: str, limit: int | None
) -> None:
    """Ask a version of the package for what is not answered yet, in processes that share the plates."""
    path = answers_path(name, engine)
    path.parent.mkdir(parents=True, exist_ok=True)
    command = [sys.executable, answering.__file__, str(data_path(name)), str(path), "--only", only]
    command += [] if limit is None else ["--limit", str(limit)]
    command += [] if minutes is None else ["--minutes", str(minutes)]
    environment = {**os.environ, "PYTHONPATH": str(tree), "OPENBLAS_NUM_THREADS": "1"}
    parts = [[*command, "--part", f"{k + 1}/{workers}"] for k in range(workers)]
    running = [subprocess.Popen(part, env=environment) for part in parts]
    for process in running:
        process.wait()


def refer(name: str, limit: int | None) -> None:
    """The answers of simple methods."""
    paths = {m: answers_path(name, m) for m in references.METHODS}
    for path in paths.values():
        path.parent.mkdir(parents=True, exist_ok=True)
    done = set.intersection(*(set(answering.answered(p)) for p in paths.values()))
    plates = {p.name: p for p in sets.SETS[name].plates}
    known: dict[str, references.Dictionary] = {}
    # first those that they stand beside
    mine = set(answering.answered(answers_path(name, THIS)))
    entries = sorted(answering.asked(data_path(name), limit=limit), key=lambda r: r["id"] not in mine)
    for entry in entries:
        if entry["id"] in done:
            continue
        plate = entry["truth"]["plate"]
        if plate not in known:
            known[plate] = references.dictionary_of(plates[plate])
        found = references.answers(known[plate], entry)
        for method, record in found.items():
            whole = {"constants": {}, "baseline": {}, **record}
            with paths[method].open("a", encoding="utf-8") as file:
                file.write(sets.line_of({"id": entry["id"], **whole}))
        print(name, entry["id"], flush=True)


def sections(results: Results) -> dict[str, str]:
    """What docs/hidden_effects.md says of each set."""
    found = {}
    for name, engines in results["sets"].items():
        if THIS in engines:
            others = {k: v for k, v in engines.items() if k != THIS}
            found[name] = scoring.section(results["lists"][name], engines[THIS], others, NAMES)
    return found


def show(results: Results) -> None:
    """Print what is said of each set."""
    for name, engines in results["sets"].items():
        for engine, own in engines.items():
            print(f"\n== {name}, {engine}: {own['lists']} lists")
            for row in own["figures"]:
                said = f"{row['value']} ({row['standard_error']}) of {row['lists']}"
                print(f"  {row['what']}: {said}, asked {row['asked']}")
            for row in own["by_kind"]:
                print("   ", {k: v for k, v in row.items() if v})


def _diagnosed(plate: Path) -> Results:
    return dict(cb.diagnose(str(plate), seed=0, next_test="never").to_dict())


def _lines(path: Path) -> list[Results]:
    return [json.loads(line) for line in path.read_text("utf-8").splitlines()]


def main(arguments: Sequence[str] | None = None) -> None:
    """Make, answer, refer, or sum up."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--quick", action="store_true")
    for option in ("--make", "--answer", "--references"):
        parser.add_argument(option, nargs="+", choices=list(sets.SETS), default=[])
    parser.add_argument("--engine", default=f"{THIS}={HERE.parent}", help="NAME=TREE of a version")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--minutes", type=float)
    parser.add_argument("--only", default="")
    parser.add_argument("--limit", type=int)
    args = parser.parse_args(arguments)
    engine, tree = args.engine.split("=", 1)
    for name in args.make:
        make(name)
    for name in args.answer:
        answer(name, engine, Path(tree), args.workers, args.minutes, args.only, args.limit)
    for name in args.references:
        refer(name, args.limit)
    results = run(args.quick)
    show(results)
    if not args.quick:
        save_results(RESULTS, results)
        write_sections(HERE.parent, RESULTS.stem, sections(results))


if __name__ == "__main__":
    main()
