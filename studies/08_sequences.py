"""How many stacking sequences do the paper's lists allow, and what noise would determine one?

python studies/08_sequences.py [--quick] [--only NAME ...] [--workers N] [--executor SPEC]

Every case of Table 9(b): the posterior over all sequences on the grid of 5 degrees, with the constants
marginalised within the paper's bounds, from the printed list with its noise inferred. Also two cases with two
unknown angles, which need no surrogate. Then the noise-free list of C1's true sequence and reference
constants, with smaller and smaller stated noise: the probability of its class. Then the cost of two to six
unknown angles, on the plate of F1 with the list of its own sequence. Every case is saved as soon as it is
done, and saved cases are kept.
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import Executor
from dataclasses import asdict
from multiprocessing import active_children
from pathlib import Path
from typing import Any

import numpy as np

from cpam_bayes.command import add_executor_options
from cpam_bayes.forward_model.build import forget_models
from cpam_bayes.parallel import open_executor
from cpam_bayes.plate import Specimen
from cpam_bayes.printed.tables import identified_layups
from cpam_bayes.render.report import Heading, Table
from cpam_bayes.render.terminal import screen_text, timed_lines
from cpam_bayes.stacking.posterior import stacking_posterior
from cpam_bayes.stacking.queries import angle_information, given_layup
from cpam_bayes.stacking.records import DEFAULT_SETTINGS, StackingPosterior, StackingSettings
from validation.reporting import (
    counted,
    paragraph,
    save_results,
    saved_results,
    study_parser,
    with_saved,
    write_sections,
)
from validation.sequences import known_angles, with_noise_free_list, with_unknown_layup

Results = dict[str, Any]
Notify = Callable[[str], None]

RESULTS = Path(__file__).parent / "results" / f"{Path(__file__).stem}.json"

KEYS = {
    "quick": "whether this is the small version",
    "cases": "one a plate and layup: printed and own sequence, credible set, most probable sequence, cost",
    "noise": "C1's own list with smaller and smaller noise stated: probability of its class",
    "cost": "seconds and memory of two to six unknown angles, the outermost of F1's plate, at two noises",
}

SEED = 0
TWO_ANGLES = {"C1, two angles": ("C1", "[(?/?)_8]_s"), "D2, two angles": ("D2", "[(?/?)_8]_s")}
PRINTED = tuple(identified_layups())
# Cases of the noise study: unknown angles of C1.
NOISE_LAYUPS = {"C1 noise, two angles": "[(?/?)_8]_s", "C1 noise": "[(?/?/?/?)_4]_s"}
NOISE = (0.02, 0.01, 0.005, 0.002, 0.001, 5e-4, 2e-4, 1e-4, 7e-5)
# Layups of the cost study by their number of unknown angles, and its noise levels.
COST_LAYUPS = {
    2: "[?/?/(0/90)_7]_s",
    3: "[?/?/?/90/(0/90)_6]_s",
    4: "[?/?/?/?/(0/90)_6]_s",
    5: "[?/?/?/?/?/90/(0/90)_5]_s",
    6: "[?/?/?/?/?/?/(0/90)_5]_s",
}
COST_NOISE = (0.01, 0.002)
COST = {f"F1's plate, {k} angles, {100 * noise:g} %": (k, noise) for noise in COST_NOISE for k in COST_LAYUPS}
NAMES = (*TWO_ANGLES, *PRINTED, *NOISE_LAYUPS, *COST)
# A class with at least this probability counts as determined.
DETERMINED = 0.95
# Number of classes whose probabilities are kept.
KEPT = 20

SMALL = StackingSettings(draws=30, listed=12, log2_points=6)


def run(
    quick: bool,
    executor: Executor | None = None,
    only: tuple[str, ...] | None = None,
    notify: Notify = lambda text: None,
) -> Results:
    """Results for all cases, or those named; quick: two angles of C1 on a coarse grid, one noise level."""
    small = ("C1, two angles", "C1 noise, two angles", next(iter(COST)))
    wanted = small if quick else only or NAMES
    settings = SMALL if quick else DEFAULT_SETTINGS
    step = 45.0 if quick else None
    cases = []
    for name in wanted:
        if name not in NOISE_LAYUPS and name not in COST:
            notify(name)
            cases.append(_case(name, step, settings, executor, notify))
    noise = [
        _noise(name, NOISE[:1] if quick else NOISE, step, settings, executor, notify)
        for name in wanted
        if name in NOISE_LAYUPS
    ]
    cost = [_cost(name, step, settings, executor, notify) for name in wanted if name in COST]
    return {"quick": quick, "cases": cases, "noise": noise, "cost": cost}


def case_specimen(name: str, step_deg: float | None = None) -> Specimen:
    """Specimen of a case, with exact sizes as in the paper, on another grid of angles if wanted."""
    return with_unknown_layup(*TWO_ANGLES.get(name, (name, None)), step_deg).with_exact_sizes()


def _case(
    name: str, step: float | None, settings: StackingSettings, executor: Executor | None, notify: Notify
) -> Results:
    specimen = case_specimen(name, step)
    answer, processor, memory = _measured(specimen, settings, executor, notify)
    information = angle_information(specimen.plate.layup, answer.marginals)
    printed = identified_layups()[name].angles_deg if name in PRINTED else None
    return {
        "case": name,
        "layup": specimen.plate.layup.text,
        "unknown_angles": answer.conditional.n_angles,
        "frequencies": answer.conditional.template.measurement.size,
        "printed": None if printed is None else _sequence(answer, np.array(printed, dtype=float)),
        "own": _sequence(answer, known_angles(specimen)),
        **_posterior(answer),
        "entropy_bits": information.entropy_bits.tolist(),
        "most_bits": information.most_bits,
        "outer_better": information.outer_better,
        "seconds": answer.seconds,
        "processor_seconds_here": processor,
        "peak_gib": memory,
    }


def _sequence(answer: StackingPosterior, angles_deg: np.ndarray) -> Results:
    found = given_layup(answer, angles_deg)
    return {
        "angles_deg": found.angles_deg.tolist(),
        "probability": found.probability,
        "rank": found.rank,
        "log_evidence_below_best": float(answer.log_evidence[0] - found.log_evidence),
    }


def _posterior(answer: StackingPosterior) -> Results:
    check = answer.check
    return {
        "enumerated": answer.enumerated,
        "credible_95_count": answer.credible_count,
        "effective_count": answer.effective_count,
        "unaccounted": answer.unaccounted,
        "learned_rms": None if check is None else check.rms,
        "check": None if check is None else asdict(check),
        "log_evidence_errors": np.quantile(answer.log_evidence_error, (0.5, 0.95, 1.0)).tolist(),
        "most_probable": {
            "angles_deg": answer.top[0].tolist(),
            "probability": float(answer.probability[0]),
            "images": int(answer.multiplicity[0]),
        },
        "classes": [
            {"angles_deg": a.tolist(), "probability": float(p), "images": int(m)}
            for a, p, m in zip(
                answer.top[:KEPT], answer.probability[:KEPT], answer.multiplicity[:KEPT], strict=True
            )
        ],
        "angle_grid_deg": answer.grid_deg.tolist(),
        "angle_marginals": answer.marginals.tolist(),
    }


def _noise(
    name: str,
    levels: tuple[float, ...],
    step: float | None,
    settings: StackingSettings,
    executor: Executor | None,
    notify: Notify,
) -> Results:
    """Answers to C1's noise-free list from the reduced model at several levels of stated noise."""
    specimen, model_error = with_unknown_layup("C1", NOISE_LAYUPS[name], step), np.nan
    rows = []
    for level in levels:
        notify(f"{name}, {100 * level:g} %")
        listed, own, model_error = with_noise_free_list(specimen, level)
        answer = stacking_posterior(listed, SEED, settings=settings, executor=executor, notify=notify)
        true = given_layup(answer, own)
        images = 1 if true.index is None else int(answer.multiplicity[true.index])
        rows.append(
            {
                "relative_std": level,
                "class_probability": images * true.probability,
                "rank": true.rank,
                "credible_95_count": answer.credible_count,
                "effective_count": answer.effective_count,
                "learned_rms": None if answer.check is None else answer.check.rms,
                "seconds": answer.seconds,
            }
        )
    enough = [r["relative_std"] for r in rows if r["class_probability"] >= DETERMINED]
    return {
        "case": name,
        "layup": specimen.plate.layup.text,
        "model_error": model_error,
        "levels": rows,
        # the largest level tried from which on down all levels determine the class
        "determined_at": max(
            (
                e
                for e in enough
                if all(r["class_probability"] >= DETERMINED for r in rows if r["relative_std"] <= e)
            ),
            default=None,
        ),
    }


def _cost(
    name: str, step: float | None, settings: StackingSettings, executor: Executor | None, notify: Notify
) -> Results:
    """Cost of the answer to one list of a plate whose outermost angles are unknown."""
    angles, noise = COST[name]
    notify(name)
    listed, _, _ = with_noise_free_list(with_unknown_layup("F1", COST_LAYUPS[angles], step), noise)
    answer, processor, memory = _measured(listed, settings, executor, notify)
    return {
        "case": name,
        "layup": listed.plate.layup.text,
        "unknown_angles": angles,
        "relative_std": noise,
        "enumerated": answer.enumerated,
        "credible_95_count": answer.credible_count,
        "unaccounted": answer.unaccounted,
        "check": None if answer.check is None else asdict(answer.check),
        "seconds": answer.seconds,
        "processor_seconds_here": processor,
        "peak_gib": memory,
    }


# Cost


def _measured(
    specimen: Specimen, settings: StackingSettings, executor: Executor | None, notify: Notify
) -> tuple[StackingPosterior, float, float]:
    """The answer without a stored model, CPU seconds of this process, and peak memory in GiB.

    The memory is that of this process and its workers; pages that they share are counted once for each.
    """
    forget_models()
    _forget_peak()
    start = time.process_time()
    answer = stacking_posterior(specimen, SEED, settings=settings, executor=executor, notify=notify)
    return answer, time.process_time() - start, _peak_gib()


def _processes() -> list[Path]:
    return [Path(f"/proc/{pid}") for pid in (os.getpid(), *(c.pid for c in active_children()))]


def _forget_peak() -> None:
    """Reset the peak memory of each process, see clear_refs in proc(5)."""
    for process in _processes():
        (process / "clear_refs").write_text("5", encoding="ascii")


def _peak_gib() -> float:
    """Sum of the processes' peak resident memories since the reset."""
    lines = [line for p in _processes() for line in (p / "status").read_text().splitlines()]
    return sum(int(line.split()[1]) for line in lines if line.startswith("VmHWM:")) / 2**20


# Output


def show(results: Results) -> None:
    """Print the results as tables."""
    cases = (
        "case",
        "unknown",
        "sequences",
        "95 % set",
        "effective",
        "most probable",
        "its p",
        "printed",
        "its p",
    )
    cases = (*cases, "rank", "s")
    rows = tuple(_row(c) for c in results["cases"])
    text = {"case", "most probable", "printed"}
    tables = [Table("Sequences", tuple(Heading(h, h not in text) for h in cases), rows)]
    noise = ("case", "noise, %", "p of the class", "rank", "95 % set", "s")
    levels = tuple(
        (
            n["case"],
            f"{100 * r['relative_std']:g}",
            f"{r['class_probability']:.3g}",
            _rank(r["rank"]),
            str(r["credible_95_count"]),
            f"{r['seconds']:.0f}",
        )
        for n in results["noise"]
        for r in n["levels"]
    )
    tables.append(Table("C1's own list", tuple(Heading(h, h != "case") for h in noise), levels))
    cost = ("case", "layup", "sequences", "95 % set", "unaccounted", "s", "GiB")
    costs = tuple(
        (
            c["case"],
            c["layup"],
            str(c["enumerated"]),
            str(c["credible_95_count"]),
            f"{c['unaccounted']:.1g}",
            f"{c['seconds']:.0f}",
            f"{c['peak_gib']:.2f}",
        )
        for c in results["cost"]
    )
    tables.append(Table("Cost", tuple(Heading(h, h not in ("case", "layup")) for h in cost), costs))
    print(screen_text(tuple(tables), sys.stdout))


def _rank(rank: int | None) -> str:
    return "beyond" if rank is None else str(rank)


def _angles(angles: list[float]) -> str:
    return "/".join(f"{a:g}" for a in angles)


def _row(c: Results) -> tuple[str, ...]:
    shown = c["printed"] or c["own"]
    return (
        c["case"],
        str(c["unknown_angles"]),
        str(c["enumerated"]),
        str(c["credible_95_count"]),
        f"{c['effective_count']:.3g}",
        _angles(c["most_probable"]["angles_deg"]),
        f"{c['most_probable']['probability']:.2g}",
        _angles(shown["angles_deg"]),
        f"{shown['probability']:.2g}",
        _rank(shown["rank"]),
        f"{c['seconds']:.0f}",
    )


# Sections of docs/unknown_angles.md


def sections(results: Results) -> dict[str, str]:
    """Sections of docs/unknown_angles.md on the paper's lists and on noise."""
    cases = [c for c in results["cases"] if c["printed"]]
    return {
        "remarks": "\n".join(paragraph(text, "- ") for text in _remarks(cases)),
        "noise": paragraph(_determined(results["noise"])),
    }


def _remarks(cases: Sequence[Results]) -> Iterable[str]:
    by_name = {c["case"]: c for c in cases}
    if {"C1", "D1"} <= set(by_name):
        c1, d1 = by_name["C1"], by_name["D1"]
        likely = sum(c["printed"]["angles_deg"] == c["most_probable"]["angles_deg"] for c in cases)
        ratio = c1["most_probable"]["probability"] / c1["printed"]["probability"]
        yield (
            "**One printed stacking sequence stands for many.** The printed stacking sequence is the most "
            f"probable one in {likely} of {len(cases)} cases. On C1 the most probable one is {ratio:.1f} "
            "times as probable as the printed one, and the 95 % set holds "
            f"{counted(c1['credible_95_count'])}. D1's 95 % set holds "
            f"{100 * d1['credible_95_count'] / d1['enumerated']:.0f} % of the grid."
        )
    if "D3" in by_name:
        below = by_name["D3"]["printed"]["log_evidence_below_best"]
        yield (
            "**A list that lacks a mode.** D3's list lacks the eighth mode ([findings](findings.md)); its "
            f"printed stacking sequence is {below:.1f} nats below the best: with the list taken as complete, "
            "others fit better than the true one."
        )


def _determined(cases: Sequence[Results]) -> str:
    each = [(c["layup"].count("?"), c["determined_at"]) for c in cases]
    reached = [f"{f'{100 * at:g} %' if at else 'none'} with {n} unknown angles" for n, at in each]
    return (
        "Largest noise at which the class of C1's true stacking sequence has probability 0.95 or more: "
        f"{', '.join(reached)}."
    )


def main() -> None:
    parser = study_parser(__doc__)
    parser.add_argument(
        "--only", nargs="+", choices=NAMES, metavar="NAME", help="of: " + ", ".join(NAMES).replace("%", "%%")
    )
    add_executor_options(parser)
    args = parser.parse_args()

    tell = timed_lines()
    with open_executor(args.executor, args.workers) as executor:
        if args.quick:
            show(run(True, executor, notify=tell))
            return
        # one at a time, so that finished cases are kept if the run is stopped
        for name in args.only or NAMES:
            save_results(RESULTS, with_saved(run(False, executor, (name,), tell), RESULTS, NAMES))
    found = saved_results(RESULTS)
    show(found)
    write_sections(Path(__file__).parents[1], RESULTS.stem, sections(found))


if __name__ == "__main__":
    main()
