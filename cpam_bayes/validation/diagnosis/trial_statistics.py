"""What many trials of the diagnosis say together: shares that were right, reliability, confusion."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from cpam_bayes.effects import CATALOGUE
from cpam_bayes.effects.frequency_list import MODE_IDENTITY
from cpam_bayes.validation.diagnosis.trials import is_right

Record = dict[str, Any]
Records = Mapping[str, Sequence[Record]]

# Bins of a probability from 0 to 1.
_BINS = 10
# Frequencies in a list from which further modes are asked for.
_MANY = 10
# A constant whose spread is below this fraction of its prior's is determined by the data.
_DETERMINED = 0.5
# List slips: no further mode can tell of them.
_OF_LIST = tuple(effect.name for effect in CATALOGUE if effect.pairings)
_CLAIMS = ("named", "class", "pair", "other")


def figures(records: Records) -> list[Record]:
    """The figures that were asked for: name, asked, value, its standard error and the number of trials."""
    every = [r for group in records.values() for r in group if r["reached"]]
    many = [r for name, group in records.items() if _modes(name) >= _MANY for r in group if r["reached"]]
    single_cause = [r for r in every if _kind(r) == "one"]
    strengths = (8.0, 4.0)
    rows = []
    for ratio, asked in zip(strengths, (">= 0.95", ">= 0.80"), strict=True):
        at = [
            r
            for r in many
            if _kind(r) == "one" and _ratio(r) == ratio and r["causes"] != [MODE_IDENTITY.name]
        ]
        rows.append(_share(f"class right, signal to noise {ratio:g}, ten modes", asked, map(is_right, at)))
        known = [r["oracle"]["right"] for r in at]
        rows.append(_share("  the oracle on the same lists", "within 0.03", known))
        few = [r for r in single_cause if _ratio(r) == ratio and r not in at]
        rows.append(
            _share(f"  the same, six modes and slips of the list, {ratio:g}", "-", map(is_right, few))
        )
    other_material = [r for r in single_cause if _ratio(r) not in strengths]
    rows.append(_share("  another material", "-", map(is_right, other_material)))
    rows.append(_share("class of the truth among the top three", ">= 0.95", map(_among_three, single_cause)))
    clean = [r for r in every if _kind(r) in ("clean", "bricks")]
    rows.append(_share("false claim on clean data", "<= 0.02", map(_is_claim, clean)))
    bricks = [r for r in clean if _kind(r) == "bricks"]
    rows.append(_share("  of plates solved on bricks", "-", map(_is_claim, bricks)))
    outside = [r for r in every if _kind(r) == "outside"]
    wrong_claims = (_is_claim(r) and r["answer"]["claim"] != "other" for r in outside)
    rows.append(_share("wrong cause claimed, truth outside", "<= 0.05", wrong_claims))
    sure = (_is_claim(r) and r["answer"]["claim"] != "other" and not _names_truth(r) for r in single_cause)
    rows.append(_share("wrong cause claimed, truth inside", "-", sure))
    for name, group in _sets(records).items():
        value, error, n = calibration_error(group)
        rows.append(_row(f"expected calibration error, {name}", "<= 0.05", value, error, n))
    extended = [r for r in every if _kind(r) == "one" and _is_claim(r)]
    rows.append(_coverage("coverage of 95 % intervals after extension", "0.92 to 0.97", extended, False))
    rows.append(_coverage("  of constants that the data determine", "-", extended, True))
    drawn = [r for r in every if _kind(r) == "prior"]
    rows.append(_coverage("  all trials from the priors", "-", drawn, False))
    said = [yes for r in single_cause for _, yes in r["said_alike"] or ()]
    rows.append(_share("said where signatures agree above 0.95", ">= 0.95", said))
    ahead = [
        r
        for r in many
        if _kind(r) == "one" and _ratio(r) >= 8.0 and r["causes"][0] not in _OF_LIST and r["further"]
    ]
    gained = (r["further"]["extended"] > r["further"]["plain"] for r in ahead)
    rows.append(_share("further modes better predicted, signal to noise 8", ">= 0.95", gained))
    claimed = (r["further"]["extended"] > r["further"]["plain"] for r in ahead if r["further"]["claimed"])
    rows.append(_share("  where something is claimed", "-", claimed))
    two = [r for r in every if _kind(r) == "two"]
    rows.append(_share("two causes: both found", "-", (_both(r) for r in two)))
    rows.append(_share("two causes: one of them leads", "-", (_one_of(r) for r in two)))
    seconds = [r["processor_seconds"] for r in every]
    if seconds:
        error = float(np.std(seconds) / np.sqrt(len(seconds)))
        rows.append(_row("processor seconds a plate", "<= 3", float(np.median(seconds)), error, len(seconds)))
    return rows


def table(records: Records) -> list[Record]:
    """By bench, cause and signal to noise: trials, shares that were right, mean probabilities."""
    cells: dict[tuple[str, str, float], list[Record]] = defaultdict(list)
    for name, group in records.items():
        for r in group:
            if r["reached"] and _kind(r) == "one":
                cells[name, r["causes"][0], _ratio(r)].append(r)
    return [
        {
            "bench": name,
            "cause": cause,
            "ratio": ratio,
            "n": len(group),
            "right": _mean(map(is_right, group)),
            "exact": _mean(r["answer"]["class"][:1] == [cause] for r in group),
            "among_three": _mean(map(_among_three, group)),
            "oracle": _mean(r["oracle"]["right"] for r in group if r["oracle"]["right"] is not None),
            "class_probability": _mean(_truth_probability(r) for r in group),
            "oracle_probability": _mean(r["oracle"]["class"] for r in group),
            "none": _mean(r["answer"]["none"] for r in group),
            "claims": dict(Counter(r["answer"]["claim"] for r in group)),
            "alike": sorted({c for r in group for c in r["alike"]} - {cause}),
        }
        for (name, cause, ratio), group in sorted(cells.items())
    ]


def confusion(records: Records) -> list[Record]:
    """By bench and signal to noise: how often each cause leads, by what was hidden."""
    cells: dict[tuple[str, float], dict[str, Counter[str]]] = defaultdict(lambda: defaultdict(Counter))
    for name, group in records.items():
        for r in group:
            if not r["reached"] or _kind(r) not in ("one", "clean", "bricks"):
                continue
            ratio = _ratio(r)
            hidden = r["causes"][0] if r["causes"] else "none"
            cells[name, ratio][hidden][_leading(r)] += 1
    return [
        {"bench": name, "ratio": ratio, "counts": {h: dict(c) for h, c in sorted(counts.items())}}
        for (name, ratio), counts in sorted(cells.items())
    ]


def reliability(records: Records) -> list[Record]:
    """Bins of the probability of the leading class, and how often it was right, by set of trials."""
    rows = []
    for name, group in _sets(records).items():
        p, right = _predictions(group)
        index = np.minimum((p * _BINS).astype(int), _BINS - 1)
        bins = [
            {"n": int(at.sum()), "probability": float(p[at].mean()), "right": float(right[at].mean())}
            for at in (index == i for i in range(_BINS))
            if at.any()
        ]
        value, error, n = calibration_error(group)
        rows.append({"set": name, "n": n, "bins": bins, "error": value, "standard_error": error})
    return rows


def unreached(records: Records) -> list[Record]:
    """Causes that could not be hidden, and why."""
    unreached_trials: dict[tuple[str, str, float], Record] = {}
    for name, group in records.items():
        for r in group:
            if not r["reached"] and _kind(r) == "one":
                key = (name, " + ".join(r["trial"]["cause"]), _ratio(r))
                largest, visible = r["most_ratio"], r["share"]
                why = f"at most {largest:.1f} within its prior"
                if largest >= _ratio(r):
                    why = f"the constants absorb it: {100 * visible:.0f} % of it is visible"
                if key not in unreached_trials or largest > unreached_trials[key]["most"]:
                    unreached_trials[key] = {
                        "bench": name,
                        "cause": key[1],
                        "ratio": key[2],
                        "most": largest,
                        "visible": visible,
                        "why": why,
                    }
    return [unreached_trials[key] for key in sorted(unreached_trials)]


def calibration_error(records: Sequence[Record]) -> tuple[float, float, int]:
    """Expected calibration error of the leading class, what chance alone would give, number of trials.

    Mean over the trials of the distance between probability and frequency in each of ten bins.
    """
    p, right = _predictions(records)
    n = len(p)
    if n == 0:
        return 0.0, 0.0, 0
    index = np.minimum((p * _BINS).astype(int), _BINS - 1)

    def error(outcome: np.ndarray[Any, Any]) -> float:
        gaps = np.bincount(index, p, _BINS) - np.bincount(index, outcome, _BINS)
        return float(np.abs(gaps).sum() / n)

    rng = np.random.default_rng(0)
    chance = [error((rng.random(n) < p).astype(float)) for _ in range(200)]
    return error(right), float(np.mean(chance)), n


def _sets(records: Records) -> dict[str, list[Record]]:
    every = [r for group in records.values() for r in group if r["reached"]]
    sets = {"truths from the priors": [r for r in every if _kind(r) == "prior"]}
    sets["hidden causes"] = [r for r in every if _kind(r) == "one"]
    return {name: group for name, group in sets.items() if group}


def _predictions(records: Sequence[Record]) -> tuple[Any, Any]:
    """Probability of the leading hypothesis or class, and whether it is that of the truth."""
    p, right = [], []
    for r in records:
        a = r["answer"]
        options = [(a["none"], not r["causes"]), (a["other"], r["causes"] == ["other"])]
        options.append((a["class_probability"], bool(set(a["class"]) & set(r["causes"]))))
        options.append((a["pair_probability"], set(a["pair"]) == set(r["causes"])))
        best = max(options, key=lambda o: o[0])
        p.append(best[0])
        right.append(best[1])
    return np.array(p, dtype=float), np.array(right, dtype=float)


def _modes(bench: str) -> int:
    return int(bench.split(", ")[1].split()[0])


def _kind(r: Record) -> str:
    return str(r["trial"]["kind"])


def _ratio(r: Record) -> float:
    return float(r["trial"]["ratio"])


def _leading(r: Record) -> str:
    """The hypothesis with most probability."""
    a = r["answer"]
    options = [(a["none"], "none"), (a["other"], "other")]
    options += [(p, name) for name, _, p, _ in a["causes"]]
    return str(max(options)[1])


def _truth_probability(r: Record) -> float:
    """Probability of the truth's class, of causes that a record keeps."""
    return float(sum(p for name, _, p, _ in r["answer"]["causes"] if name in r["alike"]))


def _among_three(r: Record) -> bool:
    singles = [name for name, *_ in r["answer"]["causes"] if " + " not in name]
    return bool(set(singles[:3]) & set(r["alike"]))


def _is_claim(r: Record) -> bool:
    return r["answer"]["claim"] in _CLAIMS


def _names_truth(r: Record) -> bool:
    return bool(set(r["answer"]["claimed"]) & set(r["alike"]))


def _both(r: Record) -> bool:
    a = r["answer"]
    return bool(a["pair_probability"] > max(a["class_probability"], a["none"], a["other"])) and set(
        a["pair"]
    ) == set(r["causes"])


def _one_of(r: Record) -> bool:
    a = r["answer"]
    first = a["pair"] if a["pair_probability"] > a["class_probability"] else a["class"]
    return bool(set(first) & set(r["causes"]))


def _coverage(name: str, asked: str, records: Sequence[Record], determined: bool) -> Record:
    inside = [
        low <= truth <= high
        for r in records
        for _, truth, _, sd, low, high, prior_sd in r["constants"]
        if not determined or sd < _DETERMINED * prior_sd
    ]
    return _share(name, asked, inside)


def _share(name: str, asked: str, outcomes: Iterable[bool]) -> Record:
    values = [bool(o) for o in outcomes]
    n = len(values)
    if n == 0:
        return _row(name, asked, None, 0.0, 0)
    p = sum(values) / n
    # of a share, with one trial of each outcome added
    smooth = (sum(values) + 1) / (n + 2)
    return _row(name, asked, p, float(np.sqrt(smooth * (1 - smooth) / n)), n)


def _row(name: str, asked: str, value: float | None, error: float, n: int) -> Record:
    return {"name": name, "asked": asked, "value": value, "error": error, "n": n}


def _mean(values: Iterable[float | bool]) -> float | None:
    numbers = [float(v) for v in values]
    return sum(numbers) / len(numbers) if numbers else None
