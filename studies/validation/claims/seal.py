"""The seal of a set: its code is committed, its seed drawn, its lists made once and answered once.

The file of the seal holds the commit of the code, the seed with its date, the predictions made before the
seed was drawn, and the SHA-256 of the lists.
"""

from __future__ import annotations

import hashlib
import json
import secrets
import subprocess
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

Record = dict[str, Any]

# Predictions for the sealed set: the figure, its least and its greatest value.
PREDICTIONS: dict[str, tuple[float, float]] = {
    "constants in their 95 % intervals": (0.93, 0.97),
    "wrong claims": (0.0, 0.01),
    "stated probability of a claim, less how often it is right": (-0.03, 0.03),
    "false claims where nothing is wrong": (0.0, 0.01),
    "constants of bricks in their 95 % intervals": (0.90, 1.0),
}


class SealError(ValueError):
    """A set that is already sealed, or lists and answers that do not belong to the seal."""


def provenance(tree: Path) -> Record:
    """Commit of a tree, whether files differ from it, and today's date."""
    code = ("cpam_bayes", "studies", ":!studies/data", ":!studies/results")
    return {
        "commit": _git(tree, "rev-parse", "HEAD")[:12],
        "dirty": bool(_git(tree, "status", "--porcelain", "--untracked-files=no", "--", *code)),
        "date": datetime.now(UTC).date().isoformat(),
    }


def draw(path: Path, tree: Path) -> Record:
    """Draw the seed of a set and write its seal.

    Raises SealError if there is one already, or if the code is not committed.
    """
    if path.exists():
        raise SealError(f"{path.name}: the set is sealed")
    of_code = provenance(tree)
    if of_code["dirty"]:
        raise SealError("the code differs from its commit")
    seal = {
        "code": of_code["commit"],
        "drawn": of_code["date"],
        "seed": secrets.randbits(40),
        "predictions": {name: list(pair) for name, pair in PREDICTIONS.items()},
    }
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(seal, indent=1) + "\n", encoding="utf-8")
    return seal


def close(path: Path, lists: Path) -> None:
    """Write the SHA-256 of the lists into their seal; raises SealError if it holds another."""
    seal, digest = json.loads(path.read_text("utf-8")), _digest(lists)
    if seal.setdefault("lists_sha256", digest) != digest:
        raise SealError(f"{lists.name}: not the lists that were sealed")
    path.write_text(json.dumps(seal, indent=1) + "\n", encoding="utf-8")


def require_closed(path: Path, lists: Path) -> Record:
    """The seal of the lists; raises SealError if they are not the sealed ones."""
    seal: Record = json.loads(path.read_text("utf-8"))
    if seal.get("lists_sha256") != _digest(lists):
        raise SealError(f"{lists.name}: not the lists that were sealed")
    return seal


def _digest(lists: Path) -> str:
    return hashlib.sha256(lists.read_bytes()).hexdigest()


def _git(tree: Path, *words: str) -> str:
    done = subprocess.run(["git", "-C", str(tree), *words], capture_output=True, text=True, check=True)
    return done.stdout.strip()
