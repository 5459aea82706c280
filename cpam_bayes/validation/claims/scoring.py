"""Scores of claims against truths: right, wrong, undecided; reliability; coverage of the constants.

A claim is right when it names the true cause, or a class that the true cause is a member of, or, of two true
causes, both or one of them without another. A truth lists the few further names that mean the same physical
thing on its plate (``accepted``). A smooth discrepancy is told by "other". Any claim on a clean list
is wrong, and so is a pair with a cause that is not there.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np

Record = dict[str, Any]
Scored = dict[str, Any]

RIGHT, WRONG, OTHER, UNDECIDED, NONE, FAILED = (
    "claimed and right",
    "claimed and wrong",
    "other",
    "undecided",
    "none",
    "error",
)
CATEGORIES = (RIGHT, WRONG, OTHER, UNDECIDED, NONE, FAILED)
# Causes are claimed by these; "none" and "undecided" claim nothing.
CLAIMS = ("named", "class", "pair")
# Units of files over SI.
_UNIT = {"E1_GPa": ("E1", 1e9), "E2_GPa": ("E2", 1e9), "nu12": ("nu12", 1.0), "G12_GPa": ("G12", 1e9)}
_BINS = 10
# Half width of a 95 % interval, in standard deviations.
_NORMAL = 1.96


def score(truth: Record, answer: Record) -> Scored:
    """The category of an answer, the size of its class, and which constants lie in their intervals.

    right : whether the answer as a whole is the truth, clean lists and "other" included.
    """
    causes, accepted = set(truth["causes"]), set(truth["accepted"])
    out: Scored = {
        "kind": truth["kind"],
        "causes": sorted(causes),
        "plate": truth["plate"],
        "ratio": truth["ratio"],
        "signal_to_noise": truth["extra"].get("signal_to_noise", truth["ratio"]),
        "stated": truth["stated"],
    }
    if "error" in answer:
        return out | {"category": FAILED, "right": False, "class_size": 0, "inside": {}, "seconds": None}
    claim, named = answer["claim"], set(answer["causes"])
    category = {"other": OTHER, "undecided": UNDECIDED, "none": NONE}.get(claim)
    if claim in CLAIMS:
        category = RIGHT if _is_true(claim, named, causes, accepted) else WRONG
    right = {
        RIGHT: True,
        OTHER: causes == {"other"},
        NONE: not causes,
    }.get(str(category), False)
    if claim == "other" and not causes:
        category = WRONG
    out |= {"claim": claim, "claimed": sorted(named), "probability": answer["probability"]}
    return out | {
        "category": category,
        "right": right,
        "class_size": len(named) if claim == "class" else 0,
        "whole": claim != "pair" or (len(causes) == 2 and named <= causes | accepted),
        "inside": coverage_of(truth, answer["constants"]),
        "inside_plain": coverage_of(truth, answer["baseline"]),
        "told_what_could_be_seen": bool(answer.get("detectable")),
        "seconds": answer.get("seconds"),
    }


def _is_true(claim: str, named: set[str], causes: set[str], accepted: set[str]) -> bool:
    known = causes | accepted
    if claim == "pair" and len(causes) == 1:
        # one thing named twice, by two names that are both the thing itself
        return named <= known or (
            causes == {"soft_clamp"} and named == {"clamp_rotation", "clamp_translation"}
        )
    if claim in ("pair", "named"):
        return bool(named) and named <= known
    return bool(named & known)


def coverage_of(truth: Record, constants: Mapping[str, Mapping[str, float]]) -> dict[str, bool]:
    """Whether each true constant lies in its 95 % interval."""
    inside = {}
    for name, interval in constants.items():
        if name not in _UNIT or _UNIT[name][0] not in truth["constants"]:
            continue
        constant, unit = _UNIT[name]
        value = truth["constants"][constant] / unit
        low = interval.get("q025", interval["mean"] - _NORMAL * interval["sd"])
        high = interval.get("q975", interval["mean"] + _NORMAL * interval["sd"])
        inside[name] = bool(low <= value <= high)
    return inside


def scored(lists: Iterable[Record], answers: Mapping[str, Record]) -> list[Scored]:
    """All lists that were answered."""
    return [
        {"id": r["id"], "set": r["set"], **score(r["truth"], answers[r["id"]])}
        for r in lists
        if "truth" in r and r["id"] in answers
    ]


def confusion(records: Sequence[Scored], by: Callable[[Scored], str]) -> list[Record]:
    """Counts of categories by a feature of the lists, with the mean size of the classes claimed rightly."""
    cells: dict[str, list[Scored]] = defaultdict(list)
    for r in records:
        cells[by(r)].append(r)
    rows = []
    for name in sorted(cells):
        group = cells[name]
        counts = Counter(r["category"] for r in group)
        sizes = [max(r["class_size"], 1) for r in group if r["category"] == RIGHT]
        rows.append(
            {
                "what": name,
                "lists": len(group),
                **{c: counts[c] for c in CATEGORIES},
                "mean class size": round(float(np.mean(sizes)), 2) if sizes else None,
                "right": round(float(np.mean([r["right"] for r in group])), 4),
            }
        )
    return rows


def reliability(records: Sequence[Scored], claims: Sequence[str]) -> Record:
    """Expected calibration error of the probability of claims, with its bins and what chance alone gives."""
    chosen = [r for r in records if r.get("claim") in claims]
    if not chosen:
        return {"lists": 0, "error": None, "by_chance": None, "bins": []}
    p = np.array([min(r["probability"], 1.0) for r in chosen])
    right = np.array([float(r["right"]) for r in chosen])
    index = np.minimum((p * _BINS).astype(int), _BINS - 1)

    def error(outcome: Any) -> float:
        gaps = np.bincount(index, p, _BINS) - np.bincount(index, outcome, _BINS)
        return float(np.abs(gaps).sum() / len(p))

    rng = np.random.default_rng(0)
    chance = float(np.mean([error((rng.random(len(p)) < p).astype(float)) for _ in range(500)]))
    bins = [
        {"lists": int(at.sum()), "probability": float(p[at].mean()), "right": float(right[at].mean())}
        for at in (index == i for i in range(_BINS))
        if at.any()
    ]
    return {"lists": len(p), "error": error(right), "by_chance": chance, "bins": bins}


def coverage(records: Sequence[Scored], which: str = "inside") -> Record:
    """Share of true constants in their 95 % intervals, with its standard error, and by constant."""
    inside = [(name, yes) for r in records for name, yes in r.get(which, {}).items()]
    by_name: dict[str, list[bool]] = defaultdict(list)
    for name, yes in inside:
        by_name[name].append(yes)
    share, error = shares([yes for _, yes in inside])
    return {
        "share": share,
        "standard_error": error,
        "constants": len(inside),
        "by_constant": {n: round(float(np.mean(v)), 4) for n, v in sorted(by_name.items())},
    }


def shares(outcomes: Sequence[bool]) -> tuple[float | None, float | None]:
    """A share and its standard error, of which an extreme one is that of one case more."""
    n = len(outcomes)
    if n == 0:
        return None, None
    share = float(np.mean(outcomes))
    p = min(max(share, 0.5 / (n + 1)), 1.0 - 0.5 / (n + 1))
    return share, float(np.sqrt(p * (1.0 - p) / n))
