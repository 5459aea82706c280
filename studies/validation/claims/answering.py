"""Answer the lists of a benchmark with a diagnosis, one JSON line each and each list only once.

python studies/validation/claims/answering.py LISTS.jsonl ANSWERS.jsonl [--only TEXT] [--limit N]
    [--minutes M] [--part K/N] [--record JSON]

Uses only ``diagnose`` of this package, so that another version can answer the same lists with PYTHONPATH set
to its tree.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Any

Record = dict[str, Any]

# Number of hypotheses that a record keeps.
_KEPT = 6
_FAILURES = (ValueError, ArithmeticError, LookupError, RuntimeError, TypeError, AttributeError, MemoryError)


def reduced(document: Record) -> Record:
    """The parts of the JSON of ``cpam-bayes diagnose --json`` that the scores need.

    constants : averaged over all hypotheses, or else of the extended model, or else of the plain one.
    """
    fit = next(d for d in (document.get("averaged"), document.get("extended"), document.get("baseline")) if d)
    constants = fit.get("constants", fit)
    keep = ("mean", "sd", "q025", "q975")
    ranked = sorted(document["hypotheses"], key=lambda h: -h["probability"])[:_KEPT]
    plain = document["baseline"]
    return {
        "claim": document["claim"],
        "causes": list(document["causes"]),
        "probability": document["probability"],
        "hypotheses": [
            {"cause": h["cause"], "probability": h["probability"], "log_bayes_factor": h["log_bayes_factor"]}
            for h in ranked
        ],
        "constants": {n: {k: c[k] for k in keep if k in c} for n, c in constants.items()},
        "baseline": {n: {k: c[k] for k in keep if k in c} for n, c in plain["constants"].items()},
        "baseline_rms_percent": plain.get("rms_percent"),
        "detectable": {d["cause"]: [d["smallest"], d["unit"]] for d in document.get("detectable") or []},
    }


def answered(path: Path) -> dict[str, Record]:
    """Answers in a file, by list; raises ValueError for a second answer to one."""
    if not path.exists():
        return {}
    found: dict[str, Record] = {}
    for line in filter(str.strip, path.read_text("utf-8").splitlines()):
        record = json.loads(line)
        if record["id"] in found:
            raise ValueError(f"{path.name}: a second answer to {record['id']}")
        found[record["id"]] = record
    return found


def asked(path: Path, only: str = "", limit: int | None = None) -> list[Record]:
    """Lists of a file in their order; only : text that their names contain."""
    lines = path.read_text("utf-8").splitlines()
    every = [json.loads(line) for line in lines]
    chosen = [r for r in every if "file" in r and only in r["id"]]
    return chosen[:limit]


def answer(
    lists: list[Record],
    path: Path,
    diagnose: Callable[[Path], Record],
    *,
    minutes: float | None = None,
    provenance: Record | None = None,
    notify: Callable[[str], None] = lambda text: None,
) -> None:
    """Answer the lists not yet answered, as long as there is time; an error is recorded as an answer.

    provenance : added to every answer
    """
    end = None if minutes is None else time.monotonic() + 60.0 * minutes
    done = answered(path)
    with tempfile.TemporaryDirectory() as folder:
        for i, entry in enumerate(lists):
            if entry["id"] in done:
                continue
            if end is not None and time.monotonic() > end:
                notify("out of time")
                return
            plate = Path(folder) / "plate.toml"
            plate.write_text(entry["file"], "utf-8")
            start = time.perf_counter()
            try:
                record = reduced(diagnose(plate))
            except _FAILURES as error:  # a list that cannot be answered is a result too, and is counted
                record = {"error": f"{type(error).__name__}: {error}", "where": traceback.format_exc()[-600:]}
            seconds = round(time.perf_counter() - start, 2)
            record = {"id": entry["id"], **record, "seconds": seconds, **(provenance or {})}
            with path.open("a", encoding="utf-8") as file:
                file.write(json.dumps(record) + "\n")
            outcome = record.get("claim", record.get("error"))
            notify(f"{i + 1}/{len(lists)} {entry['id']}: {outcome} {record.get('causes', '')}")


def main() -> None:
    """Answer a file of lists with the package that Python finds."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("lists", type=Path)
    parser.add_argument("answers", type=Path)
    parser.add_argument("--only", default="")
    parser.add_argument("--limit", type=int)
    parser.add_argument("--minutes", type=float)
    parser.add_argument("--part", default="1/1", help="K/N: the K-th of N parts")
    parser.add_argument("--record", type=json.loads, help="JSON object that every answer gets")
    options = parser.parse_args()
    import cpam_bayes as cb

    def diagnose(plate: Path) -> Record:
        return dict(cb.diagnose(str(plate), seed=0, next_test="never").to_dict())

    lists = asked(options.lists, options.only, options.limit)
    k, n = (int(t) for t in options.part.split("/"))
    answer(
        lists[k - 1 :: n],
        options.answers,
        diagnose,
        minutes=options.minutes,
        provenance=options.record,
        notify=lambda text: print(text, file=sys.stderr, flush=True),
    )


if __name__ == "__main__":
    main()
