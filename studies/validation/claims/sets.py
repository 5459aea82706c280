"""Sets of the claims benchmark: one for development, and one whose seed was drawn when all else was fixed.

Both have the same kinds of lists, each of a plate of its own. A list depends only on the seed of its set and
on its name. The order is random, so that any first part of a set is a fair sample of it.
"""

from __future__ import annotations

import json
import zlib
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from validation import brick_lists
from validation.independent import drawn
from validation.independent.lists import NominalPlate, Truth, UnreachableError
from validation.independent.true_plate import TruePlate

# Number of plates tried for a list until one can have the error.
_CANDIDATES = 6


@dataclass(frozen=True, slots=True)
class Plan:
    """A list to be made: its name, the condition on the plate, and its maker."""

    name: str
    on: Callable[[TruePlate], bool]
    make: Callable[[NominalPlate, np.random.Generator], tuple[str, Truth]]

    def candidates(self, seed: int) -> tuple[NominalPlate, ...]:
        """Plates of a set, of which the first that can have the error is used."""
        rng = np.random.default_rng([seed, zlib.crc32(self.name.encode()), 1])
        return tuple(drawn.plate(rng, self.on) for _ in range(_CANDIDATES))


PLANS = {plan[0]: Plan(*plan) for plan in (*drawn.plans(), *brick_lists.plans())}


def ordered(seed: int) -> list[str]:
    """Names of all lists of a set in its order."""
    names = list(PLANS)
    return [names[i] for i in np.random.default_rng(seed).permutation(len(names))]


def made(seed: int, name: str) -> dict[str, Any]:
    """A list of a set with its truth."""
    return made_of(PLANS[name], seed)


def made_of(plan: Plan, seed: int) -> dict[str, Any]:
    """A list with its truth and the index of its plate; the reason why not if no candidate will do."""
    why = ""
    for k, nominal in enumerate(plan.candidates(seed)):
        rng = np.random.default_rng([seed, zlib.crc32(plan.name.encode()), 2, k])
        try:
            text, truth = plan.make(nominal, rng)
        except UnreachableError as error:
            why = str(error)
            continue
        return {"id": plan.name, "plate": k, "file": text, "truth": asdict(truth)}
    return {"id": plan.name, "unreachable": why}


def line_of(record: dict[str, Any]) -> str:
    """A record as a line of JSON, with numbers of six digits."""
    return json.dumps(_short(record), allow_nan=False) + "\n"


def _short(value: Any) -> Any:
    if isinstance(value, float):
        return float(f"{value:.6g}")
    if isinstance(value, dict):
        return {k: _short(v) for k, v in value.items()}
    return [_short(v) for v in value] if isinstance(value, list | tuple) else value
