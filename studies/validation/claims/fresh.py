"""Lists of the claims benchmark under another seed, and today's answers to them."""

from __future__ import annotations

import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import cpam_bayes as cb
from cpam_bayes.errors import PlateFileError
from validation.claims import answering, scoring, sets

Record = dict[str, Any]


def another(name: str, number: int, seed: int) -> Record:
    """A list of the kind NAME of the benchmark, whose first one is NAME-0, under any number."""
    return sets.made_of(replace(sets.PLANS[f"{name}-0"], name=f"{name}-{number}"), seed)


def judged(entry: Record) -> Record:
    """Today's answer to a list and its score, in one process.

    A list that could not be made, or whose frequencies noise put out of order, has the reason instead.
    """
    if "unreachable" in entry:
        return {"id": entry["id"], "unreachable": entry["unreachable"], "seconds": 0.0}
    start = time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        plate = Path(folder) / "plate.toml"
        plate.write_text(entry["file"], "utf-8")
        try:
            document = dict(cb.diagnose(str(plate), seed=0, next_test="never").to_dict())
        except PlateFileError as error:
            reason = str(error).removeprefix(str(plate))
            return {"id": entry["id"], "unreachable": f"refused, line {reason[1:]}", "seconds": 0.0}
    score = scoring.score(entry["truth"], answering.reduced(document))
    kept = (
        "category",
        "right",
        "claim",
        "claimed",
        "probability",
        "inside",
        "inside_plain",
        "signal_to_noise",
    )
    seconds = round(time.perf_counter() - start, 1)
    return {"id": entry["id"], **{key: score[key] for key in kept}, "seconds": seconds}
