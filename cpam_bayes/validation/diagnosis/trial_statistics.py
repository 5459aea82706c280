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
# A constant whose spread is below this share of its prior's is determined by the data.
_DETERMINED = 0.5
# List slips: no further mode can tell of them.
_OF_LIST = tuple(effect.name for effect in CATALOGUE if effect.pairings)
_CLAIMS = ("named", "class", "pair", "other")


def figures(records: Records) -> list[Record]:
    """The figures that were asked for: name, asked, value, its standard error and the number of trials."""
    every = [r for own in records.values() for r in own if r["reached"]]
    many = [r for name, own in records.items() if _modes(name) >= _MANY for r in own if r["reached"]]
    one = [r for r in every if _kind(r) == "one"]
    strengths = (8.0, 4.0)
    found = []
    for ratio, asked in zip(strengths, (">= 0.95", ">= 0.80"), strict=True):
        at = [
            r
            for r in many
            if _kind(r) == "one" and _ratio(r) == ratio and r["causes"] != [MODE_IDENTITY.name]
        ]
        found.append(_share(f"class right, signal to noise {ratio:g}, ten modes", asked, map(is_right, at)))
        known = [r["oracle"]["right"] for r in at]
        found.append(_share("  the oracle on the same lists", "within 0.03", known))
        few = [r for r in one if _ratio(r) == ratio and r not in at]
        found.append(
            _share(f"  the same, six modes and slips of the list, {ratio:g}", "-", map(is_right, few))
        )
    other_material = [r for r in one if _ratio(r) not in strengths]
    found.append(_share("  another material", "-", map(is_right, other_material)))
    found.append(_share("class of the truth among the top three", ">= 0.95", map(_among_three, one)))
    clean = [r for r in every if _kind(r) in ("clean", "bricks")]
    found.append(_share("false claim on clean data", "<= 0.02", map(_is_claim, clean)))
    bricks = [r for r in clean if _kind(r) == "bricks"]
    found.append(_share("  of plates solved on bricks", "-", map(_is_claim, bricks)))
    outside = [r for r in every if _kind(r) == "outside"]
    wrong = (_is_claim(r) and r["answer"]["claim"] != "other" for r in outside)
    found.append(_share("wrong cause claimed, truth outside", "<= 0.05", wrong))
    sure = (_is_claim(r) and r["answer"]["claim"] != "other" and not _names_truth(r) for r in one)
    found.append(_share("wrong cause claimed, truth inside", "-", sure))
    for name, own in _sets(records).items():
        value, error, n = calibration_error(own)
        found.append(_row(f"expected calibration error, {name}", "<= 0.05", value, error, n))
    extended = [r for r in every if _kind(r) == "one" and _is_claim(r)]
    found.append(_coverage("coverage of 95 % intervals after extension", "0.92 to 0.97", extended, False))
    found.append(_coverage("  of constants that the data determine", "-", extended, True))
    drawn = [r for r in every if _kind(r) == "prior"]
    found.append(_coverage("  all trials from the priors", "-", drawn, False))
    said = [yes for r in one for _, yes in r["said_alike"] or ()]
    found.append(_share("said where signatures agree above 0.95", ">= 0.95", said))
    ahead = [
        r
        for r in many
        if _kind(r) == "one" and _ratio(r) >= 8.0 and r["causes"][0] not in _OF_LIST and r["further"]
    ]
    gained = (r["further"]["extended"] > r["further"]["plain"] for r in ahead)
    found.append(_share("further modes better predicted, signal to noise 8", ">= 0.95", gained))
    claimed = (r["further"]["extended"] > r["further"]["plain"] for r in ahead if r["further"]["claimed"])
    found.append(_share("  where something is claimed", "-", claimed))
    two = [r for r in every if _kind(r) == "two"]
    found.append(_share("two causes: both found", "-", (_both(r) for r in two)))
    found.append(_share("two causes: one of them leads", "-", (_one_of(r) for r in two)))
    seconds = [r["processor_seconds"] for r in every]
    if seconds:
        error = float(np.std(seconds) / np.sqrt(len(seconds)))
        found.append(
            _row("processor seconds a plate", "<= 3", float(np.median(seconds)), error, len(seconds))
        )
    return found


def table(records: Records) -> list[Record]:
    """By bench, cause and signal to noise: trials, shares that were right, mean probabilities."""
    cells: dict[tuple[str, str, float], list[Record]] = defaultdict(list)
    for name, own in records.items():
        for r in own:
            if r["reached"] and _kind(r) == "one":
                cells[name, r["causes"][0], _ratio(r)].append(r)
    return [
        {
            "bench": name,
            "cause": cause,
            "ratio": ratio,
            "n": len(own),
            "right": _mean(map(is_right, own)),
            "exact": _mean(r["answer"]["class"][:1] == [cause] for r in own),
            "among_three": _mean(map(_among_three, own)),
            "oracle": _mean(r["oracle"]["right"] for r in own if r["oracle"]["right"] is not None),
            "class_probability": _mean(_truth_probability(r) for r in own),
            "oracle_probability": _mean(r["oracle"]["class"] for r in own),
            "none": _mean(r["answer"]["none"] for r in own),
            "claims": dict(Counter(r["answer"]["claim"] for r in own)),
            "alike": sorted({c for r in own for c in r["alike"]} - {cause}),
        }
        for (name, cause, ratio), own in sorted(cells.items())
    ]


def confusion(records: Records) -> list[Record]:
    """By bench and signal to noise: how often each cause leads, by what was hidden."""
    cells: dict[tuple[str, float], dict[str, Counter[str]]] = defaultdict(lambda: defaultdict(Counter))
    for name, own in records.items():
        for r in own:
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
    found = []
    for name, own in _sets(records).items():
        p, right = _predictions(own)
        index = np.minimum((p * _BINS).astype(int), _BINS - 1)
        bins = [
            {"n": int(at.sum()), "probability": float(p[at].mean()), "right": float(right[at].mean())}
            for at in (index == i for i in range(_BINS))
            if at.any()
        ]
        value, error, n = calibration_error(own)
        found.append({"set": name, "n": n, "bins": bins, "error": value, "standard_error": error})
    return found


def unreached(records: Records) -> list[Record]:
    """Causes that could not be hidden, and why."""
    found: dict[tuple[str, str, float], Record] = {}
    for name, own in records.items():
        for r in own:
            if not r["reached"] and _kind(r) == "one":
                key = (name, " + ".join(r["trial"]["cause"]), _ratio(r))
                most, share = r["most_ratio"], r["share"]
                why = f"at most {most:.1f} within its prior"
                if most >= _ratio(r):
                    why = f"the constants absorb it: {100 * share:.0f} % of it is visible"
                if key not in found or most > found[key]["most"]:
                    found[key] = {
                        "bench": name,
                        "cause": key[1],
                        "ratio": key[2],
                        "most": most,
                        "visible": share,
                        "why": why,
                    }
    return [found[key] for key in sorted(found)]


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
    every = [r for own in records.values() for r in own if r["reached"]]
    found = {"truths from the priors": [r for r in every if _kind(r) == "prior"]}
    found["hidden causes"] = [r for r in every if _kind(r) == "one"]
    return {name: own for name, own in found.items() if own}


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
    own = [bool(o) for o in outcomes]
    n = len(own)
    if n == 0:
        return _row(name, asked, None, 0.0, 0)
    p = sum(own) / n
    # of a share, with one trial of each outcome added
    smooth = (sum(own) + 1) / (n + 2)
    return _row(name, asked, p, float(np.sqrt(smooth * (1 - smooth) / n)), n)


def _row(name: str, asked: str, value: float | None, error: float, n: int) -> Record:
    return {"name": name, "asked": asked, "value": value, "error": error, "n": n}


def _mean(values: Iterable[float | bool]) -> float | None:
    own = [float(v) for v in values]
    return sum(own) / len(own) if own else None
