"""Are the probabilities of stacking sequences those that a slow and independent way gives?

python studies/14_sequence_reference.py [--quick] [--only NAME ...] [--workers N] [--executor SPEC]

Lists of a plate's own sequence and reference constants, noise-free, with 1 % or 0.2 % of noise stated. The
reference climbs from other starts, eight of a library of its own beside the common ones, on the whole reduced
model instead of the one about the posterior, and samples 2048 points. It is asked for the most probable
sequences and for draws from the posterior. Then sequences are drawn from all of the grid, so many of each
layer of the surrogate, those that it has far below the best among them: they estimate the sum over all
sequences, and the most by which such a one exceeds the surrogate.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from concurrent.futures import Executor
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.command import add_executor_options
from cpam_bayes.parallel import open_executor
from cpam_bayes.render.report import Heading, Table
from cpam_bayes.render.terminal import screen_text, timed_lines
from cpam_bayes.stacking.evaluation import Evaluated, evaluate, scan_library
from cpam_bayes.stacking.listing import surrogate_values
from cpam_bayes.stacking.posterior import stacking_posterior, stacking_problem
from cpam_bayes.stacking.records import DEFAULT_SETTINGS, StackingProblem, StackingSettings
from cpam_bayes.stacking.search import training_problem
from cpam_bayes.stacking.symmetry import all_sequences, classes
from cpam_bayes.stacking.training import TrainingSettings, train
from validation.reporting import (
    markdown_table,
    save_results,
    saved_results,
    study_parser,
    with_saved,
    write_sections,
)
from validation.sequences import with_noise_free_list, with_unknown_layup

Array = NDArray[Any]
Results = dict[str, Any]
Notify = Callable[[str], None]

RESULTS = Path(__file__).parent / "results" / f"{Path(__file__).stem}.json"

KEYS = {
    "quick": "whether this is the small version",
    "cases": "one each: errors of the log evidence on the top and on draws, sum over all, layer by layer",
}

SEED = 0


class Case(NamedTuple):
    """A built-in plate, what is unknown of its layup, and the noise that its list states."""

    plate: str
    layup: str
    noise: float


class Effort(NamedTuple):
    """Of the reference: log2 of its points, the members of its library that an optimisation begins at.

    each : sequences drawn of a layer that weighs
    """

    log2_points: int = 11
    starts: int = 8
    each: int = 150


CASES = {
    "C1, 4 angles, 1 %": Case("C1", "[(?/?/?/?)_4]_s", 0.01),
    "C1, 4 angles, 0.2 %": Case("C1", "[(?/?/?/?)_4]_s", 0.002),
    "F1, 6 angles, 1 %": Case("F1", "[?/?/?/?/?/?/(0/90)_5]_s", 0.01),
    "F1, 6 angles, 0.2 %": Case("F1", "[?/?/?/?/?/?/(0/90)_5]_s", 0.002),
}
LIBRARY = 768
# Layers of the surrogate, nats below its top, and log2 of the points of what is drawn of them.
LAYERS = (-10.0, 3.0, 6.0, 9.0, 12.0, 16.0, 22.0, 30.0, 45.0, np.inf)
LAYER_POINTS = 9
# The share of the sequences of a layer that are drawn of one that begins so far below, nats.
FAR_SHARE, FAR = 1 / 3, 12.0
# Of so many sequences the sum over all is estimated; of more the surrogate would have to be enumerated.
MOST_SUMMED = 3_000_000
QUICK = Case("C1", "[(?/?/?)_5/0]_s", 0.01)
SMALL = StackingSettings(
    exhaustive=100,
    training=TrainingSettings(initial=60, exploration_rounds=2, max_size=150),
    listed=8,
    draws=20,
)


def run(
    quick: bool,
    executor: Executor | None = None,
    only: tuple[str, ...] | None = None,
    notify: Notify = lambda text: None,
) -> Results:
    """All cases or those named; quick: three angles on a coarse grid."""
    if quick:
        few = Effort(log2_points=6, starts=1, each=6)
        return {"quick": True, "cases": [_case("C1, small", QUICK, 30.0, SMALL, few, executor, notify)]}
    cases = [
        _case(name, CASES[name], None, DEFAULT_SETTINGS, Effort(), executor, notify) for name in only or CASES
    ]
    return {"quick": False, "cases": cases}


def _case(
    name: str,
    case: Case,
    step: float | None,
    settings: StackingSettings,
    effort: Effort,
    executor: Executor | None,
    notify: Notify,
) -> Results:
    notify(name)
    specimen, _, _ = with_noise_free_list(with_unknown_layup(case.plate, case.layup, step), case.noise)
    start = time.perf_counter()
    answer = stacking_posterior(specimen, SEED, settings=settings, executor=executor, notify=notify)
    notify("the reference")
    problem = stacking_problem(specimen, SEED, settings=settings, executor=executor)
    top = _reference(problem, answer.components.sequences, effort)
    drawn = _reference(problem, answer.drawn.sequences, effort)
    miss = answer.drawn.log_evidence - drawn.log_evidence
    row: Results = {
        "case": name,
        "enumerated": answer.enumerated,
        "log_evidence": answer.log_evidence_total,
        "unaccounted": answer.unaccounted,
        "top": _errors(answer.log_evidence - top.log_evidence, top),
        "drawn_with_care": _errors(miss, drawn),
        "drawn_as_known": None if answer.check is None else answer.check.rms,
        "laplace": _errors(drawn.fits.log_evidence - drawn.log_evidence, drawn),
        "sum": None,
        "layers": [],
    }
    if answer.enumerated <= MOST_SUMMED:
        notify("all layers")
        row |= _summed(problem, effort)
    return row | {"seconds": time.perf_counter() - start}


def _reference(problem: StackingProblem, sequences: Array, effort: Effort) -> Evaluated:
    """Sequences (m, k) by the slow way."""
    library = scan_library(problem.conditional, LIBRARY, np.random.default_rng([SEED, 77]))
    return evaluate(
        problem.conditional,
        problem.grid_deg,
        sequences,
        problem.starts,
        effort.log2_points,
        problem.executor,
        library,
        scanned=effort.starts,
    )


def _errors(miss: Array, reference: Evaluated) -> Results:
    return {
        "n": len(miss),
        "rms": float(np.sqrt(np.mean(miss**2))),
        "mean": float(miss.mean()),
        "largest": float(np.abs(miss).max()),
        "within": float(np.mean(np.abs(miss) <= 0.1)),
        "reference_error": float(np.median(reference.conditionals.error)),
    }


def _summed(problem: StackingProblem, effort: Effort) -> Results:
    """The sum over all sequences from layers of the surrogate, by ratio estimates."""
    rng = np.random.default_rng([SEED, 4])  # the surrogate is trained as for the answer
    sums = problem.sums
    assert sums is not None, "so few sequences need no surrogate"
    surrogate = train(training_problem(problem, sums), rng, lambda text: None).surrogate
    g, k = len(problem.grid_deg), problem.n_unknown
    distinct = classes(all_sequences(g, k), problem.symmetries)
    sequences, size = distinct.representative, distinct.size
    known = surrogate_values(surrogate, problem.executor, sums.features(sequences))
    below = known.max() - known
    pick_rng = np.random.default_rng([SEED, 5])
    rows = []
    for low, high in pairwise(LAYERS):
        own = np.flatnonzero((below >= low) & (below < high))
        if not len(own):
            continue
        drawn = effort.each if low < FAR else round(FAR_SHARE * effort.each)
        pick = np.sort(pick_rng.choice(own, size=min(drawn, len(own)), replace=False))
        found = _reference(problem, sequences[pick], effort._replace(log2_points=LAYER_POINTS))
        value = size[pick] * np.exp(found.log_evidence - known.max())
        expected = size[pick] * np.exp(known[pick] - known.max())
        ratio = float(value.sum() / expected.sum())
        mass = float(size[own] @ np.exp(-below[own]))
        left = 1.0 - len(pick) / len(own)
        spread = np.std(value - ratio * expected) / expected.mean() / np.sqrt(len(pick)) * np.sqrt(left)
        miss = found.log_evidence - known[pick]
        rows.append(
            {
                "from": float(max(low, 0.0)),
                "to": float(min(high, below.max())),
                "classes": len(own),
                "drawn": len(pick),
                "learned_mass": mass,
                "mass": ratio * mass,
                "mass_error": float(spread * mass),
                "rms": float(np.sqrt(np.mean(miss**2))),
                "most_above": float(miss.max()),
                "highest": float(found.log_evidence.max() - known.max()),
            }
        )
    total = sum(r["mass"] for r in rows)
    error = float(np.sqrt(sum(r["mass_error"] ** 2 for r in rows)))
    log_mean = float(np.log(total) + known.max() - np.log(problem.n_sequences))
    return {"sum": {"log_evidence": log_mean, "relative_error": error / total}, "layers": rows}


def show(results: Results) -> None:
    """Print the results as tables."""
    heads = (
        "case",
        "top: rms",
        "largest",
        "draws: rms",
        "largest",
        "as known",
        "Laplace",
        "log Z",
        "reference",
    )
    rows = tuple(
        (
            c["case"],
            f"{c['top']['rms']:.3f}",
            f"{c['top']['largest']:.2f}",
            f"{c['drawn_with_care']['rms']:.3f}",
            f"{c['drawn_with_care']['largest']:.2f}",
            "-" if c["drawn_as_known"] is None else f"{c['drawn_as_known']:.3f}",
            f"{c['laplace']['rms']:.2f}",
            f"{c['log_evidence']:.4f}",
            "-" if c["sum"] is None else f"{c['sum']['log_evidence']:.4f}({c['sum']['relative_error']:.4f})",
        )
        for c in results["cases"]
    )
    found = [Table("Log evidence, nats", tuple(Heading(h, i > 0) for i, h in enumerate(heads)), rows)]
    for c in results["cases"]:
        if not c["layers"]:
            continue
        titles = (
            "nats below",
            "to",
            "classes",
            "drawn",
            "surrogate mass",
            "mass",
            "rms",
            "most above",
            "highest",
        )
        lines = tuple(
            (
                f"{r['from']:.0f}",
                f"{r['to']:.0f}",
                str(r["classes"]),
                str(r["drawn"]),
                f"{r['learned_mass']:.4g}",
                f"{r['mass']:.4g}({r['mass_error']:.1g})",
                f"{r['rms']:.2f}",
                f"{r['most_above']:.2f}",
                f"{r['highest']:.1f}",
            )
            for r in c["layers"]
        )
        found.append(Table(f"Layers of {c['case']}", tuple(Heading(t, True) for t in titles), lines))
    print(screen_text(tuple(found), sys.stdout))


# Sections of docs/unknown_angles.md


def sections(results: Results) -> dict[str, str]:
    """What docs/unknown_angles.md says of errors of log evidences."""
    head = ("list", "stacking sequences", "rms", "within 0.1", "largest")
    rows = (
        (
            c["case"],
            str(c["drawn_with_care"]["n"]),
            f"{c['drawn_with_care']['rms']:.3f}",
            f"{100 * c['drawn_with_care']['within']:.1f} %",
            f"{c['drawn_with_care']['largest']:.2f}",
        )
        for c in results["cases"]
    )
    return {"errors": markdown_table(head, rows)}


def main() -> None:
    """Run the study, print its tables and save the results, case by case."""
    parser = study_parser(__doc__)
    parser.add_argument(
        "--only", nargs="+", choices=CASES, metavar="NAME", help="of: " + "; ".join(CASES).replace("%", "%%")
    )
    add_executor_options(parser)
    args = parser.parse_args()

    tell = timed_lines()
    with open_executor(args.executor, args.workers) as executor:
        if args.quick:
            show(run(True, executor, notify=tell))
            return
        for name in args.only or CASES:
            save_results(RESULTS, with_saved(run(False, executor, (name,), tell), RESULTS, tuple(CASES)))
    found = saved_results(RESULTS)
    show(found)
    write_sections(Path(__file__).parents[1], RESULTS.stem, sections(found))


if __name__ == "__main__":
    main()
