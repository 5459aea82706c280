"""Scores of claims against truths, and the figures and tables that are made of them.

A claim is right when it names the true cause, or a class that the true cause is a member of, or, of two true
causes, both or one of them without another. A truth lists the few further names that mean the same physical
thing on its plate (``accepted``). A smooth discrepancy is told by "other". Any claim on a clean list
is wrong, and so is a pair with a cause that is not there.

A cause above the detection limit that the answer states for it must be claimed, alone or in a class.
"""

from __future__ import annotations

import tomllib
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from scipy.stats import binomtest

from validation.independent.true_plate import FLAWS
from validation.reporting import paragraph

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
# Causes are claimed by these; "none" and "undecided" claim nothing.
CLAIMS = ("named", "class", "pair")
# Units of files over SI.
_UNIT = {"E1_GPa": ("E1", 1e9), "E2_GPa": ("E2", 1e9), "nu12": ("nu12", 1.0), "G12_GPa": ("G12", 1e9)}
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
        {
            "id": r["id"],
            **{key: answers[r["id"]].get(key, "-") for key in ("commit", "date")},
            **score(r["truth"], answers[r["id"]]),
            "above_limit": above_limit(r, answers[r["id"]]),
        }
        for r in lists
        if "truth" in r and r["id"] in answers
    ]


# Detection limits

# Units of limits over those of hidden sizes, which are SI and degrees.
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
# What a limit states: the chance of a claim at this size, and of most larger ones.
LIMIT_CHANCE = (0.95, 1.0)
ABOVE, BELOW = "errors above their stated limit, claimed", "errors below their stated limit, claimed"


def above_limit(entry: Record, answer: Record) -> bool | None:
    """Whether the one cause that a list hides is as large as the limit that the answer states for it.

    Where it states that no size is seen, none is above. None: the cause has no size or no limit, or there
    are two.
    """
    size = hidden_size(entry)
    limit = answer.get("detectable", {}).get(entry["truth"]["causes"][0]) if size is not None else None
    if size is None or limit is None:
        return None
    smallest, unit = limit
    return smallest is not None and bool(OF_LIMIT[unit] * size >= smallest)


def hidden_size(entry: Record) -> float | None:
    """The size of the one cause that a list hides as limits measure it, SI and degrees; None: see above."""
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
    """Of the plate as its file states it, kg."""
    plate = tomllib.loads(file)["plate"]
    if "mass_g" in plate:
        return float(plate["mass_g"]) / 1e3
    return (
        float(plate["density_kg_m3"] * plate["length_mm"] * plate["width_mm"] * plate["thickness_mm"]) / 1e9
    )


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


def honesty(records: Sequence[Scored], claims: Sequence[str]) -> Record:
    """Mean stated probability of claims that state one, less how often they are right, with its error."""
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
    """Share of true constants in their 95 % intervals, its standard error over lists, and by constant."""
    each = [list(r[which].values()) for r in records if r.get(which)]
    by_name: dict[str, list[bool]] = defaultdict(list)
    for r in records:
        for name, yes in r.get(which, {}).items():
            by_name[name].append(yes)
    share, error = None, None
    if each:
        inside, number = (np.array([f(v) for v in each], dtype=float) for f in (sum, len))
        share = float(inside.sum() / number.sum())
        # of one constant more that is outside, where none is
        scatter = np.sum((inside - share * number) ** 2) + 0.25
        error = float(np.sqrt(scatter) / number.sum())
    return {
        "share": share,
        "standard_error": error,
        "constants": sum(len(v) for v in each),
        "by_constant": {n: round(float(np.mean(v)), 4) for n, v in sorted(by_name.items())},
    }


def interval(successes: int, n: int) -> tuple[float, float]:
    """The exact 95 % interval of a share (Clopper and Pearson, Biometrika 26, 1934)."""
    low, high = binomtest(successes, n).proportion_ci(0.95, "exact")
    return float(low), float(high)


# Figures of a set of lists

# Signal to noise from which a cause should be found.
_STRONG = 8.0
STRONG = "claimed and right, signal to noise 8 and above"
# Groups of lists by the first part of their names.
HEADLINE, STRESS = "drawn from priors", "by signal to noise"
GROUPS = {
    "clean": HEADLINE,
    "prior": HEADLINE,
    "two": HEADLINE,
    "list": HEADLINE,
    "bricks": "bricks",
    "beyond": "what no cause is",
    "former": "what misled earlier versions",
    "strength": STRESS,
}


def group_of(r: Scored) -> str:
    """The group of lists that a list belongs to."""
    return GROUPS[str(r["id"]).split("-")[0]]


def summary(records: Sequence[Scored]) -> Record:
    """Everything that is said of one engine's answers to one set."""
    return {
        "lists": len(records),
        "by_commit": dict(sorted(Counter(f"{r['commit']} of {r['date']}" for r in records).items())),
        "by_kind": confusion(records, kind_of),
        "by_ratio": confusion([r for r in records if group_of(r) == STRESS], ratio_of),
        "by_noise": confusion(records, lambda r: "noise stated" if r["stated"] else "noise left out"),
        "by_cause": confusion(records, lambda r: " + ".join(r["causes"]) or "nothing"),
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
    }


def _groups(records: Sequence[Scored]) -> list[str]:
    return [name for name in dict.fromkeys(GROUPS.values()) if any(group_of(r) == name for r in records)]


def figures(records: Sequence[Scored]) -> list[Record]:
    """The figures that are predicted, then further ones: what, value, 95 % interval, number of lists."""
    drawn = [r for r in records if group_of(r) == HEADLINE]
    bricks = [r for r in records if group_of(r) == "bricks"]
    clean = [r for r in records if not r["causes"]]
    strong = [r for r in records if r["causes"] not in ([], ["other"]) and _strength(r) >= _STRONG]
    hard = [r for r in records if group_of(r) in ("what no cause is", "what misled earlier versions")]
    stated = honesty(records, (*CLAIMS, "other"))
    return [
        _covered("constants in their 95 % intervals", drawn),
        _counted("wrong claims", records, _is(WRONG)),
        _row(
            "stated probability of a claim, less how often it is right",
            stated["difference"],
            stated["standard_error"],
            stated["lists"],
        ),
        _counted("false claims where nothing is wrong", clean, _is(WRONG)),
        _covered("constants of bricks in their 95 % intervals", bricks),
        _covered("constants, of what no cause is and what misled earlier versions", hard),
        _counted(STRONG, strong, _is(RIGHT)),
        _counted("right or open, of what no cause is and what misled earlier versions", hard, _is_not(WRONG)),
        _counted(ABOVE, [r for r in records if r.get("above_limit") is True], _is(RIGHT)),
        _counted(BELOW, [r for r in records if r.get("above_limit") is False], _is(RIGHT)),
    ]


def kind_of(r: Scored) -> str:
    """What a list holds, for tables."""
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
    """The signal to noise of a list as text that sorts."""
    return f"{r['ratio']:3.0f}"


def section(
    total: int,
    scores: Record,
    beside: Sequence[str] = (),
    seal: Record | None = None,
) -> str:
    """Markdown of a set: figures beside what was predicted, other methods, what was claimed, wrong claims.

    beside : the lines of `compared`
    """
    lines = [f"{scores['lists']} of {total} lists answered, in random order."]
    predicted = {ABOVE: LIMIT_CHANCE} | ({} if seal is None else seal["predictions"])
    if seal is not None:
        lines += [
            f"Code of commit {seal['code']}, seed {seal['seed']} drawn on {seal['drawn']}. Answered by "
            + ", ".join(f"{commit} ({n})" for commit, n in scores["by_commit"].items())
            + "."
        ]
    lines += ["", "| | predicted | reached | 95 % interval | of |", "|---|---|---|---|---|"]
    for row in scores["figures"]:
        if row["number"]:
            at = predicted.get(row["what"])
            low, high = row["interval"]
            lines.append(
                f"| {row['what']} | {'-' if at is None else f'{at[0]:g} to {at[1]:g}'} | {row['value']:.3f} "
                f"| {low:.3f} to {high:.3f} | {row['number']} {row['unit']} |"
            )
    plain = scores["coverage"]["plain model"]
    if plain["constants"]:
        lines += ["", f"Of the 95 % intervals of the plain model {plain['share']:.3f} hold the truth."]
    lines += ["", _confusion_table("what is hidden", scores["by_kind"]), *beside]
    if scores["wrong"]:
        lines += ["", "Wrong claims:", "", "| list | hidden | claimed | probability |", "|---|---|---|---|"]
        lines += [
            f"| {w['id']} | {', '.join(w['causes']) or 'nothing'} "
            f"| {w['claim']}: {', '.join(w['claimed'])} | {w['probability']:.3f} |"
            for w in scores["wrong"]
        ]
    return "\n".join([*lines, ""])


def compared(beside: Record, tuned: Record, names: Mapping[str, str]) -> list[str]:
    """Lines of Markdown of other methods beside the diagnosis, on the lists that all answered.

    beside : the number of lists, figures and confusion by engine. tuned : the rate and the thresholds.
    """
    wrong, of = tuned["rate"]
    said = (
        f"Simple methods on the {beside['lists']} lists that all answered. They have the true constants and "
        "the truths' own elements, which favours them. Each claims from a threshold on, the least at which "
        f"its rate of wrong claims on development lists is at most the diagnosis's ({wrong} of {of})."
    )
    lines = [
        "",
        paragraph(said),
        "",
        "| | threshold | development: right, wrong, lists | right | wrong | right, signal to noise from 8 |",
        "|---|---|---|---|---|---|",
    ]
    for engine, scores in beside["engines"].items():
        chosen = tuned["methods"].get(engine)
        least, counts = "-", "-"
        if chosen is not None:
            least = "abstains" if chosen["threshold"] is None else f"{chosen['threshold']:.4g}"
            counts = ", ".join(str(chosen[key]) for key in (RIGHT, WRONG, "lists"))
        strong = next(row for row in scores["figures"] if row["what"] == STRONG)
        found = f"{round(strong['number'] * (strong['value'] or 0.0))} of {strong['number']}"
        lines.append(
            f"| {names.get(engine, engine)} | {least} | {counts} | {_number(scores, RIGHT)} "
            f"| {_number(scores, WRONG)} | {found} |"
        )
    return lines


def in_short(total: int, scores: Record) -> str:
    """Markdown of one point of a list: how often claims are wrong, and how often intervals hold the truth."""
    n, wrong = int(scores["lists"]), _number(scores, WRONG)
    low, high = (100.0 * end for end in interval(wrong, n))
    held = scores["coverage"]["all"]
    said = f"{n} lists" if n == total else f"{n} of {total} lists so far"
    counted = "1 wrong claim" if wrong == 1 else f"{wrong} wrong claims"
    return (
        "**On independent elements and bricks**, sealed before they were answered "
        f"([hidden effects](docs/hidden_effects.md), {said}): {counted} (95 % interval {low:.1f} "
        f"to {high:.1f} % of the lists); {100.0 * held['share']:.0f} % of {held['constants']} intervals of "
        "95 % held the truth."
    )


def _confusion_table(what: str, rows: Sequence[Record]) -> str:
    shown = [c for c in CATEGORIES if any(r[c] for r in rows)]
    head = [what, "lists", *shown]
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    lines += [
        "| " + " | ".join(str(c) for c in (r["what"], r["lists"], *(r[c] for c in shown))) + " |"
        for r in rows
    ]
    return "\n".join(lines)


def _number(scores: Record, category: str) -> int:
    return sum(int(row[category]) for row in scores["by_kind"])


def _strength(r: Scored) -> float:
    """Signal to noise of a list; what is no shift, a mode missed, or was not measured, counts as strong."""
    value = r["signal_to_noise"]
    return float("inf") if value is None else float(value) * 1.001


def _is(category: str) -> Callable[[Scored], bool]:
    return lambda r: bool(r["category"] == category)


def _is_not(category: str) -> Callable[[Scored], bool]:
    return lambda r: bool(r["category"] != category)


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
