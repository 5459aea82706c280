"""Are the claims of the diagnosis right? Truths from independent elements and bricks, off every grid.

python studies/15_claims.py [--seal] [--make SET ...] [--answer SET ...] [--methods SET ...]
    [--engine NAME=TREE] [--workers N] [--minutes M] [--only TEXT] [--limit N] [--quick]
python studies/15_claims.py --score FILE [--of SET]

A list is a plate file with its truth, one JSON line in studies/data/claims/SET.jsonl: "id", "file", "truth".
The set "development" is for inspection. The set "sealed" is for judging: --seal draws its seed once the code
is committed and writes the predictions down beside it; --make then makes the lists once, --answer asks the
diagnosis once for each, with the commit and the date in the answer. Without these options the existing
answers are turned into results and into the section of docs/hidden_effects.md.

--methods adds what users do instead, each with a threshold to abstain that is chosen on the set "development"
for the diagnosis's own rate of wrong claims there; --engine NAME=TREE asks another version of the package.

--score prints the scores of your own method beside ours on the same lists, and writes nothing. FILE holds an
answer per line, see validation/own_method.py. The method may use the "file" of a list only: its "id" and its
"truth" tell what is hidden.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any

import cpam_bayes as cb
from validation import own_method
from validation.claims import answering, references, scoring, seal, sets, telling
from validation.fingerprints import KEY, fingerprint_of_study
from validation.reporting import save_results, write_sections

Results = dict[str, Any]

HERE = Path(__file__).parent
RESULTS = HERE / "results" / f"{Path(__file__).stem}.json"
DATA = HERE / "data" / "claims"
SEAL = DATA / "seal.json"

KEYS = {
    "quick": "whether this is the small version",
    "seal": "of the sealed set: commit of the code, date, seed, predictions, SHA-256 of the lists",
    "lists": "by set: how many there are",
    "unreachable": "by set: lists that could not be made, and why",
    "engines": "by set, the states of the code that answered, each with its figures",
    "sets": "by set, of the diagnosis: figures, confusion of claims and more",
    "thresholds": "wrong claims of the diagnosis on lists for development, by whom, and thresholds by them",
    "beside": "by set, on the lists that all engines and methods answered: figures and confusion of each",
}

DEVELOPMENT, SEALED = NAMES_OF_SETS = ("development", "sealed")
DEVELOPMENT_SEED = 5150
THIS = "diagnosis"
# Scores of each method that are kept for the comparison.
BRIEF = ("by_kind", "by_ratio", "figures")
NAMES = {m: f"{m.replace('_', ' ')}, {statistic}" for m, statistic in references.METHODS.items()}
QUICK_LIST = "strength-clamp_length-8"


def seed_of(name: str) -> int:
    """Seed of a set; raises FileNotFoundError if it has not been drawn yet."""
    return DEVELOPMENT_SEED if name == DEVELOPMENT else int(json.loads(SEAL.read_text("utf-8"))["seed"])


def data_path(name: str) -> Path:
    """File with the lists of a set."""
    return DATA / f"{name}.jsonl"


def answers_path(name: str, engine: str) -> Path:
    """File with the answers of an engine or a method to a set."""
    return DATA / "answers" / f"{name}_{engine}.jsonl"


def run(quick: bool) -> Results:
    """Scores of all existing answers; quick: one list of the development set, made and answered."""
    if quick:
        entries = [sets.made(DEVELOPMENT_SEED, QUICK_LIST)]
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "answers.jsonl"
            answering.answer(entries, path, _diagnosed)
            answers = {THIS: answering.answered(path)}
        return _results(True, {DEVELOPMENT: (entries, answers)})
    found = {}
    for name in NAMES_OF_SETS:
        if data_path(name).exists():
            engines = {
                p.stem.removeprefix(f"{name}_"): answering.answered(p)
                for p in sorted((DATA / "answers").glob(f"{name}_*.jsonl"))
            }
            found[name] = (_lines(data_path(name)), engines)
    return _results(False, found)


def _results(quick: bool, found: dict[str, tuple[list[Results], dict[str, dict[str, Results]]]]) -> Results:
    tuned = _tuned(*found.get(DEVELOPMENT, ([], {})))
    said: Results = {}
    beside: Results = {}
    states: list[Results] = []
    for name, (entries, engines) in found.items():
        if THIS not in engines:
            continue
        scores = {}
        for engine in (THIS, *(e for e in engines if e != THIS)):
            answers = engines[engine]
            if engine in tuned["methods"]:
                answers = references.abstaining(answers, tuned["methods"][engine]["threshold"])
            scores[engine] = scoring.scored(entries, answers)
        said[name] = scoring.summary(scores[THIS])
        states += [{"set": name, **row} for row in scoring.by_engine(scores[THIS])]
        both = set.intersection(*({r["id"] for r in records} for records in scores.values()))
        of_both = {e: scoring.summary([r for r in s if r["id"] in both]) for e, s in scores.items()}
        brief = {engine: {key: own[key] for key in BRIEF} for engine, own in of_both.items()}
        beside[name] = {"lists": len(both), "engines": brief}
    return {
        "quick": quick,
        "seal": seal.require_closed(SEAL, data_path(SEALED)) if SEALED in found else None,
        "lists": {name: sum("file" in r for r in entries) for name, (entries, _) in found.items()},
        "unreachable": {
            name: [{"id": r["id"], "why": r["unreachable"]} for r in entries if "unreachable" in r]
            for name, (entries, _) in found.items()
        },
        "engines": states,
        "sets": said,
        "thresholds": tuned,
        "beside": beside,
    }


def _tuned(entries: list[Results], engines: dict[str, dict[str, Results]]) -> Results:
    """Thresholds at which the methods claim wrongly as often as the diagnosis does on a set."""
    ours = scoring.scored(entries, engines.get(THIS, {}))
    rate = sum(r["category"] == scoring.WRONG for r in ours), len(ours)
    methods = {
        m: references.threshold(
            scoring.scored(entries, engines[m]), {k: a["statistic"] for k, a in engines[m].items()}, rate
        )
        for m in references.METHODS
        if m in engines
    }
    by = [row["commit"] for row in scoring.by_engine(ours)]
    return {"rate": list(rate), "answered_by": by, "methods": methods}


def make(name: str, workers: int) -> None:
    """Write the lists of a set, all or none."""
    path, seed = data_path(name), seed_of(name)
    if name == SEALED and path.exists():
        raise seal.SealError(f"{path.name}: the lists are made")
    path.parent.mkdir(parents=True, exist_ok=True)
    lines = []
    with ProcessPoolExecutor(workers) as pool:
        for record in pool.map(partial(sets.made, seed), sets.ordered(seed)):
            lines.append(sets.line_of(record))
            print(name, len(lines), record["id"], record.get("unreachable", ""), flush=True)
    path.write_text("".join(lines), encoding="utf-8")
    if name == SEALED:
        seal.close(SEAL, path)


def answer(
    name: str, engine: str, tree: Path, workers: int, minutes: float | None, only: str, limit: int | None
) -> None:
    """Ask a version of the package for the missing answers, in processes that share the lists."""
    if name == SEALED:
        seal.require_closed(SEAL, data_path(SEALED))
    path = answers_path(name, engine)
    path.parent.mkdir(parents=True, exist_ok=True)
    command = [sys.executable, answering.__file__, str(data_path(name)), str(path), "--only", only]
    command += ["--record", json.dumps(_provenance(tree))]
    command += [] if limit is None else ["--limit", str(limit)]
    command += [] if minutes is None else ["--minutes", str(minutes)]
    environment = {**os.environ, "PYTHONPATH": str(tree), "OPENBLAS_NUM_THREADS": "1"}
    parts = [[*command, "--part", f"{k + 1}/{workers}"] for k in range(workers)]
    running = [subprocess.Popen(part, env=environment) for part in parts]
    for process in running:
        process.wait()


def _provenance(tree: Path) -> Results:
    """Record kept with each answer: commit and date, and for this tree the fingerprint of today's code."""
    own = {KEY: fingerprint_of_study(RESULTS.stem)} if tree.resolve() == HERE.parent.resolve() else {}
    return {**seal.provenance(tree), **own}


def refer(name: str, minutes: float | None, limit: int | None) -> None:
    """Answer with the simple methods, as long as there is time."""
    end = math.inf if minutes is None else time.monotonic() + 60.0 * minutes
    paths = {m: answers_path(name, m) for m in references.METHODS}
    for path in paths.values():
        path.parent.mkdir(parents=True, exist_ok=True)
    done = set.intersection(*(set(answering.answered(p)) for p in paths.values()))
    # first the lists that the diagnosis has answered
    mine = set(answering.answered(answers_path(name, THIS)))
    entries = sorted(answering.asked(data_path(name), limit=limit), key=lambda r: r["id"] not in mine)
    for entry in (e for e in entries if e["id"] not in done):
        if time.monotonic() > end:
            return
        nominal = sets.PLANS[entry["id"]].candidates(seed_of(name))[entry["plate"]]
        found = references.answers(references.dictionary_of(nominal), entry)
        for method, record in found.items():
            with paths[method].open("a", encoding="utf-8") as file:
                file.write(sets.line_of({"id": entry["id"], **record}))
        print(name, entry["id"], flush=True)


def scores_beside_ours(name: str, path: Path) -> str:
    """Text on a method's own answers to a set; raises AnswerError for an invalid file."""
    entries = answering.asked(data_path(name))
    own = own_method.read(path, {entry["id"] for entry in entries})
    ours = answering.answered(answers_path(name, THIS))
    both = [entry for entry in entries if entry["id"] in own and entry["id"] in ours]
    records = (scoring.scored(both, answers) for answers in (own, ours))
    left = len(own) - len(both)
    others = f"\n\n{left} of its answers are to lists that the diagnosis has not answered." if left else ""
    return f"{own_method.table(path.stem, *records)}{others}"


def sections(results: Results) -> dict[str, str]:
    """Sections of docs/hidden_effects.md on each set, and of README on the sealed one."""
    found = {}
    for name, scores in results["sets"].items():
        total, beside = results["lists"][name], results["beside"][name]
        states = [row for row in results["engines"] if row["set"] == name]
        others = telling.compared(beside, results["thresholds"], NAMES) if len(beside["engines"]) > 1 else []
        sealed = results["seal"] if name == SEALED else None
        found[name] = telling.section(total, scores, states, others, sealed)
        if sealed is not None:
            found["in short"] = telling.in_short(total, scores, sealed, len(states))
    return found


def show(results: Results) -> None:
    """Print the section on each set."""
    for name, text in sections(results).items():
        print(f"\n== {name}\n\n{text}")


def _diagnosed(plate: Path) -> Results:
    return dict(cb.diagnose(str(plate), seed=0, next_test="never").to_dict())


def _lines(path: Path) -> list[Results]:
    return [json.loads(line) for line in path.read_text("utf-8").splitlines()]


def main(arguments: Sequence[str] | None = None) -> None:
    """Seal, make, answer, run the simple methods, or sum up."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--seal", action="store_true", help="draw the seed of the sealed set")
    for option in ("--make", "--answer", "--methods"):
        parser.add_argument(option, nargs="+", choices=NAMES_OF_SETS, default=[])
    parser.add_argument("--engine", default=f"{THIS}={HERE.parent}", help="NAME=TREE of a version")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--minutes", type=float)
    parser.add_argument("--only", default="")
    parser.add_argument("--limit", type=int)
    parser.add_argument("--score", type=Path, metavar="FILE", help="score these answers of another method")
    parser.add_argument("--of", choices=NAMES_OF_SETS, default=SEALED, help="the set that they are of")
    args = parser.parse_args(arguments)
    if args.score:
        try:
            print(scores_beside_ours(args.of, args.score))
        except (own_method.AnswerError, OSError) as error:
            parser.error(str(error))
        return
    engine, tree = args.engine.split("=", 1)
    if args.seal:
        print(json.dumps(seal.draw(SEAL, HERE.parent), indent=1))
    for name in args.make:
        make(name, args.workers)
    for name in args.answer:
        answer(name, engine, Path(tree), args.workers, args.minutes, args.only, args.limit)
    for name in args.methods:
        refer(name, args.minutes, args.limit)
    results = run(args.quick)
    show(results)
    if not args.quick:
        save_results(RESULTS, results)
        write_sections(HERE.parent, RESULTS.stem, sections(results))


if __name__ == "__main__":
    main()
