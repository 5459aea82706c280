"""Scores of claims against truths, and summary figures of the scores.

A claim is right if it names the true cause, or a class that contains the true cause, or, of two true causes,
both or one of them alone. A truth lists the few other names of the same physical thing on its plate
(``accepted``). A smooth discrepancy is rightly called "other". Any claim on a clean list is wrong, and so is
a pair with a false cause.

A cause above the detection limit that the answer states for it must be claimed, alone or in a class.
"""

from __future__ import annotations

import tomllib
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from scipy.stats import binomtest

from validation.fingerprints import KEY, UNKNOWN
from validation.independent.true_plate import FLAWS

Record = dict[str, Any]
Scored = dict[str, Any]

RIGHT, WRONG, OTHER, UNDECIDED, NONE, MISSED, FAILED = CATEGORIES = (
    "claimed and right",
    "claimed and wrong",
    "other",
    "undecided",
    "none",
    "missed",
    "error",
)
# Key in a confusion table, beside the counts.
CLASS_SIZE = "mean class size"
# Claims that name causes; "none" and "undecided" claim nothing.
CLAIMS = ("named", "class", "pair")
# Units of files relative to SI.
_UNIT = {"E1_GPa": ("E1", 1e9), "E2_GPa": ("E2", 1e9), "nu12": ("nu12", 1.0), "G12_GPa": ("G12", 1e9)}
# Half width of a 95 % interval, in standard deviations.
_NORMAL = 1.96


def score(truth: Record, answer: Record) -> Scored:
    """Category of an answer, the size of its class, and which constants lie in their intervals.

    right : whether the whole answer agrees with the truth, including clean lists and "other".
    """
    causes, accepted = set(truth["causes"]), set(truth["accepted"])
    out: Scored = {
        "kind": truth["kind"],
        "causes": sorted(causes),
        "ratio": truth["ratio"],
        "signal_to_noise": truth["extra"].get("signal_to_noise", truth["ratio"]),
        "stated": truth["stated"],
    }
    if "error" in answer:
        return out | {"category": FAILED, "right": False, "class_size": 0, "inside": {}, "seconds": None}
    claim, named = answer["claim"], set(answer["causes"])
    nothing = MISSED if causes else NONE
    category = {"other": OTHER, "undecided": UNDECIDED, "none": nothing}.get(claim)
    if claim in CLAIMS:
        category = RIGHT if _is_true(claim, named, causes, accepted) else WRONG
    right = {RIGHT: True, OTHER: causes == {"other"}, NONE: True}.get(str(category), False)
    if claim == "other" and not causes:
        category = WRONG
    out |= {"claim": claim, "claimed": sorted(named), "probability": answer.get("probability")}
    return out | {
        "category": category,
        "right": right,
        "class_size": len(named) if claim == "class" else 0,
        "inside": coverage_of(truth, answer["constants"]),
        "inside_plain": coverage_of(truth, answer["baseline"]),
        "seconds": answer.get("seconds"),
    }


def _is_true(claim: str, named: set[str], causes: set[str], accepted: set[str]) -> bool:
    known = causes | accepted
    if claim == "pair" and len(causes) == 1:
        # one thing given two names, both of which are right
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
    """Scores of all lists that were answered."""
    order = {name: place for place, name in enumerate(answers)}
    return [
        {
            "id": r["id"],
            "order": order[r["id"]],
            **{key: answers[r["id"]].get(key, "-") for key in ("commit", "date")},
            "dirty": answers[r["id"]].get("dirty", False),
            KEY: answers[r["id"]].get(KEY, UNKNOWN),
            **score(r["truth"], answers[r["id"]]),
            "above_limit": above_limit(r, answers[r["id"]]),
        }
        for r in lists
        if "truth" in r and r["id"] in answers
    ]


# Detection limits

# Units of limits relative to those of hidden sizes, which are SI and degrees.
OF_LIMIT = {
    "%": 1e2,
    "% of the area": 1e2,
    "mm": 1e3,
    "um": 1e6,
    "g": 1e3,
    "MPa": 1e-6,
    "Hz": 1.0,
    "deg": 1.0,
    "": 1.0,
}
# Probability of a claim at the limit, and at larger sizes up to nearly one.
LIMIT_CHANCE = (0.95, 1.0)
ABOVE, BELOW = "errors above their stated limit, claimed", "errors below their stated limit, claimed"


def above_limit(entry: Record, answer: Record) -> bool | None:
    """Whether the single hidden cause of a list is at least as large as the answer's stated detection limit.

    False if the answer states that no size is detectable. None: the cause has no size or no limit, or there
    are two.
    """
    size = hidden_size(entry)
    limit = answer.get("detectable", {}).get(entry["truth"]["causes"][0]) if size is not None else None
    if size is None or limit is None:
        return None
    smallest, unit = limit
    return smallest is not None and bool(OF_LIMIT[unit] * size >= smallest)


def hidden_size(entry: Record) -> float | None:
    """Size of the single hidden cause of a list, in the measure of limits, SI and degrees; None as above."""
    truth = entry["truth"]
    if len(truth["causes"]) != 1:
        return None
    (cause,) = truth["causes"]
    if cause in truth["sizes"]:
        aux, mass = truth["aux"].get(cause, {}), _mass(entry["file"])
        return FLAWS[cause].stated(truth["sizes"][cause], aux, mass)
    # one misread frequency, in per cent
    return abs(truth["extra"]["shift_percent"]) / 1e2 if cause == "outlier" else None


def _mass(file: str) -> float:
    """Mass of the plate as stated in its file, kg."""
    plate = tomllib.loads(file)["plate"]
    if "mass_g" in plate:
        return float(plate["mass_g"]) / 1e3
    return (
        float(plate["density_kg_m3"] * plate["length_mm"] * plate["width_mm"] * plate["thickness_mm"]) / 1e9
    )


def confusion(records: Sequence[Scored], by: Callable[[Scored], str]) -> list[Record]:
    """Counts of categories by a feature of the lists, with the mean size of the classes rightly claimed."""
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
                CLASS_SIZE: round(float(np.mean(sizes)), 2) if sizes else None,
                "right": round(float(np.mean([r["right"] for r in group])), 4),
            }
        )
    return rows


def honesty(records: Sequence[Scored], claims: Sequence[str]) -> Record:
    """Mean stated probability of claims that state one, minus the fraction that is right, with its error."""
    chosen = [r for r in records if r.get("claim") in claims and r["probability"] is not None]
    if not chosen:
        return {"lists": 0, "difference": None, "standard_error": None}
    p = np.array([min(r["probability"], 1.0) for r in chosen])
    off = p - np.array([float(r["right"]) for r in chosen])
    return {
        "lists": len(off),
        "difference": float(off.mean()),
        "standard_error": float(np.sqrt(np.sum(p * (1.0 - p)) + 0.25) / len(off)),
    }


def coverage(records: Sequence[Scored], which: str = "inside") -> Record:
    """Fraction of true constants in their 95 % intervals, its standard error over lists, and by constant."""
    each = [list(r[which].values()) for r in records if r.get(which)]
    by_name: dict[str, list[bool]] = defaultdict(list)
    for r in records:
        for name, yes in r.get(which, {}).items():
            by_name[name].append(yes)
    share, error = None, None
    if each:
        inside, number = (np.array([f(v) for v in each], dtype=float) for f in (sum, len))
        share = float(inside.sum() / number.sum())
        # as if one more constant were outside, so that the error is never zero
        scatter = np.sum((inside - share * number) ** 2) + 0.25
        error = float(np.sqrt(scatter) / number.sum())
    return {
        "share": share,
        "standard_error": error,
        "constants": sum(len(v) for v in each),
        "by_constant": {n: round(float(np.mean(v)), 4) for n, v in sorted(by_name.items())},
    }


def interval(successes: int, n: int) -> tuple[float, float]:
    """Exact 95 % interval of a binomial proportion (Clopper and Pearson, Biometrika 26, 1934)."""
    low, high = binomtest(successes, n).proportion_ci(0.95, "exact")
    return float(low), float(high)


# Figures of a set of lists

# Signal to noise above which a cause should be found.
_STRONG = 8.0
STRONG = "claimed and right, signal to noise 8 and above"
# Signal-to-noise limits between missed causes hidden by noise, weak and strong ones.
_BANDS = (1.0, _STRONG)
# Groups of lists by the first part of their names.
HEADLINE, STRESS, BRICKS = "drawn from priors", "by signal to noise", "bricks"
# Figures that are reported individually.
TOO_SURE = "stated probability of a claim, less how often it is right"
COVERED, COVERED_OF_BRICKS = (
    "constants in their 95 % intervals",
    "constants of bricks in their 95 % intervals",
)
WRONG_CLAIMS, WRONG_OF_ELEMENTS, WRONG_OF_BRICKS = (
    "wrong claims",
    "wrong claims, elements",
    "wrong claims, bricks",
)
GROUPS = {
    "clean": HEADLINE,
    "prior": HEADLINE,
    "two": HEADLINE,
    "list": HEADLINE,
    "bricks": BRICKS,
    "beyond": "outside the catalogue",
    "former": "what misled earlier versions",
    "strength": STRESS,
}
# Groups of lists whose names describe the hidden error between the first and the last part.
OF_PATTERNS = (GROUPS["beyond"], GROUPS["former"])


def group_of(r: Scored) -> str:
    """Group that a list belongs to."""
    return GROUPS[str(r["id"]).split("-")[0]]


def summary(records: Sequence[Scored]) -> Record:
    """Complete summary of one engine's answers to one set."""
    return {
        "lists": len(records),
        "by_kind": confusion(records, kind_of),
        "by_ratio": confusion([r for r in records if group_of(r) == STRESS], ratio_of),
        "by_noise": confusion(records, lambda r: "noise stated" if r["stated"] else "noise left out"),
        "by_cause": confusion(records, lambda r: " + ".join(r["causes"]) or "nothing"),
        "by_pattern": by_pattern(records),
        "figures": figures(records),
        "coverage": {
            **{name: coverage([r for r in records if group_of(r) == name]) for name in _groups(records)},
            "all": coverage(records),
            "plain model": coverage(records, "inside_plain"),
        },
        "wrong": [
            {k: r.get(k) for k in ("id", "causes", "claim", "claimed", "probability")}
            for r in records
            if r["category"] == WRONG
        ],
        "misled": misled(records),
    }


def by_pattern(records: Sequence[Scored]) -> list[Record]:
    """Claims and covered constants by error that is outside the catalogue or misled earlier versions."""
    cells: dict[tuple[str, str], list[Scored]] = defaultdict(list)
    for r in records:
        if group_of(r) in OF_PATTERNS:
            cells[group_of(r), " ".join(str(r["id"]).split("-")[1:-1])].append(r)
    return [
        {
            "what": name,
            "of": group,
            "lists": len(own),
            RIGHT: sum(r["category"] == RIGHT or (r["right"] and r["category"] == OTHER) for r in own),
            WRONG: sum(r["category"] == WRONG for r in own),
            MISSED: sum(r["category"] in (MISSED, FAILED) for r in own),
            "inside": sum(sum(r["inside"].values()) for r in own),
            "constants": sum(len(r["inside"]) for r in own),
        }
        for (group, name), own in sorted(cells.items())
    ]


def by_engine(records: Sequence[Scored]) -> list[Record]:
    """States of the code that answered, in the order of their first answers, each with its own figures.

    dirty : answers given while files of the code differed from the commit
    """
    found: dict[tuple[str, ...], list[Scored]] = defaultdict(list)
    for r in sorted(records, key=lambda r: int(r["order"])):
        found[r["commit"], r["date"], r[KEY]].append(r)
    return [
        {
            "commit": commit,
            "date": date,
            KEY: fingerprint,
            "lists": len(own),
            "dirty": sum(bool(r["dirty"]) for r in own),
            "figures": figures(own),
        }
        for (commit, date, fingerprint), own in found.items()
    ]


def misled(records: Sequence[Scored]) -> list[Record]:
    """Ways in which claims mislead, the commonest first: how often, among how many lists, for which causes.

    Either an existing error is not claimed, by its signal to noise, or another cause is claimed.
    """
    bands = [
        ("missed", MISSED, low, high) for low, high in zip((0.0, *_BANDS), (*_BANDS, np.inf), strict=True)
    ]
    rows = []
    for way, category, low, high in (*bands, ("another cause claimed", WRONG, 0.0, np.inf)):
        of = [r for r in records if category == WRONG or (r["causes"] and low <= _ratio(r) < high)]
        own = [r for r in of if r["category"] == category]
        rows.append(
            {
                "way": way,
                "from": low,
                "below": None if high == np.inf else high,
                "number": len(own),
                "of": len(of),
                "causes": dict(Counter(cause for r in own for cause in r["causes"]).most_common()),
            }
        )
    return sorted((row for row in rows if row["number"]), key=lambda row: -row["number"])


def _groups(records: Sequence[Scored]) -> list[str]:
    return [name for name in dict.fromkeys(GROUPS.values()) if any(group_of(r) == name for r in records)]


def figures(records: Sequence[Scored]) -> list[Record]:
    """The predicted figures, then further ones: name, value, 95 % interval, number of lists."""
    drawn = [r for r in records if group_of(r) == HEADLINE]
    bricks = [r for r in records if group_of(r) == BRICKS]
    elements = [r for r in records if group_of(r) != BRICKS]
    clean = [r for r in records if not r["causes"]]
    strong = [r for r in records if r["causes"] not in ([], ["other"]) and _strength(r) >= _STRONG]
    stated = honesty(records, (*CLAIMS, "other"))
    return [
        _covered(COVERED, drawn),
        _counted(WRONG_CLAIMS, records, _is(WRONG)),
        _row(
            TOO_SURE,
            stated["difference"],
            stated["standard_error"],
            stated["lists"],
        ),
        _counted("false claims where nothing is wrong", clean, _is(WRONG)),
        _covered(COVERED_OF_BRICKS, bricks),
        _counted(STRONG, strong, _is(RIGHT)),
        _counted(ABOVE, [r for r in records if r.get("above_limit") is True], _is(RIGHT)),
        _counted(BELOW, [r for r in records if r.get("above_limit") is False], _is(RIGHT)),
        _counted(WRONG_OF_ELEMENTS, elements, _is(WRONG)),
        _counted(WRONG_OF_BRICKS, bricks, _is(WRONG)),
    ]


def kind_of(r: Scored) -> str:
    """Kind of error in a list, for tables."""
    name = str(r["id"]).split("-")
    said = {
        "clean": "nothing",
        "prior": "one cause",
        "two": "two causes",
        "list": "an error of the list",
        "strength": "one cause, by signal to noise",
    }
    return said.get(name[0], GROUPS[name[0]])


def ratio_of(r: Scored) -> str:
    """Signal to noise of a list as text that sorts."""
    return f"{r['ratio']:3.0f}"


def _strength(r: Scored) -> float:
    """Signal to noise of a list; an unmeasured one, or a missed mode, which is no shift, counts as strong."""
    return _ratio(r) * 1.001


def _ratio(r: Scored) -> float:
    value = r["signal_to_noise"]
    return 1e9 if value is None else float(value)


def number_of(scores: Record, category: str) -> int:
    """Number of lists of a summary in a category."""
    return sum(int(row[category]) for row in scores["by_kind"])


def figure_of(scores: Record, what: str) -> Record:
    """One of the figures of a summary."""
    return next(row for row in scores["figures"] if row["what"] == what)


def _is(category: str) -> Callable[[Scored], bool]:
    return lambda r: bool(r["category"] == category)


def _counted(what: str, records: Sequence[Scored], test: Callable[[Scored], bool]) -> Record:
    n, yes = len(records), sum(test(r) for r in records)
    between = interval(yes, n) if n else (0.0, 1.0)
    return {"what": what, "value": yes / n if n else None, "interval": between, "number": n, "unit": "lists"}


def _covered(what: str, records: Sequence[Scored]) -> Record:
    found = coverage(records)
    row = _row(what, found["share"], found["standard_error"], found["constants"], "constants")
    between = None if row["interval"] is None else tuple(min(max(end, 0.0), 1.0) for end in row["interval"])
    return {**row, "interval": between}


def _row(what: str, value: float | None, error: float | None, n: int, unit: str = "claims") -> Record:
    between = None if value is None or error is None else (value - 2.0 * error, value + 2.0 * error)
    return {"what": what, "value": value, "interval": between, "number": n, "unit": unit}
