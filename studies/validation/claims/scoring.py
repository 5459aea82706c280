"""Scores of claims against truths, and the figures and tables that are made of them.

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


# Figures of a set of lists

# Signal to noise from which a cause should be found.
_STRONG = 8.0
_CLEAN = ("clean", "coincident", "incomplete, clean")


def summary(records: Sequence[Scored]) -> Record:
    """Everything that is said of one engine's answers to one set."""
    return {
        "lists": len(records),
        "plates": sorted({r["plate"] for r in records}),
        "by_kind": confusion(records, row_of),
        "by_ratio": confusion([r for r in records if r["kind"] == "one"], ratio_of),
        "by_noise": confusion(records, lambda r: "noise stated" if r["stated"] else "noise left out"),
        "by_cause": confusion(
            [r for r in records if r["kind"] in ("one", "prior", "row")], lambda r: " + ".join(r["causes"])
        ),
        "figures": figures(records),
        "reliability": {
            "claims": reliability(records, (*CLAIMS, "other")),
            "claims and none": reliability(records, (*CLAIMS, "other", "none")),
        },
        "coverage": {
            "all": coverage(records),
            "claimed": coverage([r for r in records if r["category"] in (RIGHT, WRONG)]),
            "clean": coverage([r for r in records if r["kind"] in _CLEAN]),
            "plain model": coverage(records, "inside_plain"),
        },
        "wrong": [
            {k: r.get(k) for k in ("id", "plate", "causes", "claim", "claimed", "probability")}
            for r in records
            if r["category"] == WRONG
        ],
    }


def figures(records: Sequence[Scored]) -> list[Record]:
    """The figures that were asked for: what, asked, reached, its standard error, number of lists."""
    every = [r for r in records if r["causes"] and r["kind"] != "smooth" and _strength(r) >= _STRONG]
    rows = [_row("claimed and right, signal to noise 8 and above", "-", every, _is(RIGHT))]
    rows.append(_row("wrong claims, all lists", "<= 0.01", records, _is(WRONG)))
    smooth = [r for r in records if r["kind"] == "smooth"]
    rows.append(_row("wrong claims, smooth discrepancy", "<= 0.02", smooth, _is(WRONG)))
    clean = [r for r in records if not r["causes"]]
    rows.append(_row("false claims, nothing hidden", "<= 0.01", clean, _is(WRONG)))
    calibration = reliability(records, (*CLAIMS, "other"))
    rows.append(
        _value(
            "expected calibration error of claims",
            "<= 0.03",
            calibration["error"],
            None,
            calibration["lists"],
        )
    )
    every_interval = coverage(records)
    rows.append(
        _value(
            "coverage of 95 % intervals, claimed or not",
            "0.93 to 0.97",
            every_interval["share"],
            every_interval["standard_error"],
            every_interval["constants"],
        )
    )
    return rows


def row_of(r: Scored) -> str:
    """The row of known failures, or the kind, that a list belongs to, by its name."""
    name = str(r["id"])
    return name.rsplit("-", 1)[0] if r.get("set") == "rows" else str(r["kind"])


def ratio_of(r: Scored) -> str:
    """The signal to noise of a list as text that sorts."""
    return "-" if r["ratio"] is None else f"{r['ratio']:3.0f}"


def section(total: int, scores: Record, others: Mapping[str, Record], names: Mapping[str, str]) -> str:
    """Markdown of a set: figures, claims by signal to noise, wrong claims, and those of other methods."""
    lines = [
        f"{scores['lists']} of {total} lists answered, at random within a plate.",
        "",
        "| | reached (standard error) | lists |",
        "|---|---|---|",
    ]
    lines += [f"| {row['what']} | {_shown(row)} | {row['lists']} |" for row in scores["figures"]]
    cover = scores["coverage"]["plain model"]
    if cover["constants"]:
        lines += ["", f"Of the 95 % intervals of the plain model {_number(cover['share'])} hold the truth."]
    if others:
        wrong = [f"{names.get(name, name)} {_claimed_and_wrong(of)}" for name, of in others.items()]
        own = f"this diagnosis {_claimed_and_wrong(scores)}"
        lines += ["", f"Wrong on the same lists: {', '.join([own, *wrong])}."]
    if any(r["what"] != "-" for r in scores["by_ratio"]):
        said = "Single causes by signal to noise:"
        lines += ["", said, "", _confusion_table("signal to noise", scores["by_ratio"])]
    if scores["wrong"]:
        lines += ["", "Wrong claims:", "", "| list | hidden | claimed | probability |", "|---|---|---|---|"]
        lines += [
            f"| {w['id']} | {', '.join(w['causes']) or 'nothing'} "
            f"| {w['claim']}: {', '.join(w['claimed'])} | {w['probability']:.3f} |"
            for w in scores["wrong"]
        ]
    return "\n".join([*lines, ""])


def _confusion_table(what: str, rows: Sequence[Record]) -> str:
    shown = [c for c in CATEGORIES if any(r[c] for r in rows)]
    head = [what, "lists", *shown]
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    lines += [
        "| " + " | ".join(str(c) for c in (r["what"], r["lists"], *(r[c] for c in shown))) + " |"
        for r in rows
    ]
    return "\n".join(lines)


def _claimed_and_wrong(scores: Record) -> int:
    return sum(int(row[WRONG]) for row in scores["by_kind"])


def _strength(r: Scored) -> float:
    """Signal to noise of a list; what is no shift, a mode missed or another material, counts as strong."""
    value = r["signal_to_noise"]
    return float("inf") if value is None else float(value) * 1.001


def _is(category: str) -> Callable[[Scored], bool]:
    return lambda r: bool(r["category"] == category)


def _row(what: str, asked: str, records: Sequence[Scored], test: Callable[[Scored], bool]) -> Record:
    return _of(what, asked, [test(r) for r in records])


def _of(what: str, asked: str, outcomes: Sequence[bool]) -> Record:
    return _value(what, asked, *shares(outcomes), len(outcomes))


def _value(what: str, asked: str, value: float | None, error: float | None, n: int) -> Record:
    return {"what": what, "asked": asked, "value": value, "standard_error": error, "lists": n}


def _shown(row: Record) -> str:
    error = row["standard_error"]
    return _number(row["value"]) + (f" ({error:.3f})" if error is not None else "")


def _number(value: Any) -> str:
    return "-" if value is None else f"{value:.3f}"
