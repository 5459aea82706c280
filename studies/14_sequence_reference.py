"""Are the probabilities of stacking sequences those of nested sampling, and is none overlooked?

python studies/14_sequence_reference.py [--quick] [--only NAME ...] [--workers N] [--executor SPEC]

Lists of a plate's own sequence and reference constants, noise-free, with 1 % or 0.2 % of noise stated.
Sequences are drawn from the posterior, and the log evidences of the first ten classes of each list are
computed again by static nested sampling (dynesty, the extra `audit`) on the whole reduced model instead of
the one about the posterior. If all sequences can be enumerated, others are drawn from the whole grid, some
from each layer of the surrogate's values, including those far below the best: they estimate the sum over all
sequences, and the most by which a sequence of each layer exceeds the surrogate.
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
from cpam_bayes.parallel import run as run_items
from cpam_bayes.render.report import Heading, Table
from cpam_bayes.render.terminal import screen_text, timed_lines
from cpam_bayes.stacking.conditional import ConditionalPosterior
from cpam_bayes.stacking.evaluation import evaluate, scan_library
from cpam_bayes.stacking.listing import surrogate_values
from cpam_bayes.stacking.posterior import stacking_posterior, stacking_problem
from cpam_bayes.stacking.records import DEFAULT_SETTINGS, StackingProblem, StackingSettings
from cpam_bayes.stacking.search import training_problem
from cpam_bayes.stacking.symmetry import all_sequences, canonical, classes
from cpam_bayes.stacking.training import TrainingSettings, train
from validation.nested import nested_of_scores
from validation.reporting import (
    markdown_table,
    paragraph,
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
    "live_points": "of every run of nested sampling",
    "cases": "one each: both log evidences of classes drawn, their summary, sum over all, layer by layer",
}

SEED = 0


class Case(NamedTuple):
    """A built-in plate, the unknowns of its layup, and the noise that its list states."""

    plate: str
    layup: str
    noise: float


class Effort(NamedTuple):
    """Computational effort of the check.

    nested : number of drawn sequences whose evidence is computed by nested sampling.
    live_points : of each nested run.
    each : sequences drawn per layer of the surrogate that carries weight.
    """

    nested: int = 10
    live_points: int = 500
    each: int = 60


CASES = {
    "C1, 4 angles, 1 %": Case("C1", "[(?/?/?/?)_4]_s", 0.01),
    "C1, 4 angles, 0.2 %": Case("C1", "[(?/?/?/?)_4]_s", 0.002),
    "F1, 6 angles, 1 %": Case("F1", "[?/?/?/?/?/?/(0/90)_5]_s", 0.01),
    "F1, 6 angles, 0.2 %": Case("F1", "[?/?/?/?/?/?/(0/90)_5]_s", 0.002),
}
# Bounds of the surrogate's layers, nats below its maximum.
LAYERS = (-10.0, 3.0, 6.0, 9.0, 12.0, 16.0, 22.0, 30.0, 45.0, np.inf)
# For the sequences of a layer: log2 of the importance points of each, size of the library of constants from
# which optimisations start, and number of its members used.
LAYER_POINTS, LIBRARY, STARTS = 9, 768, 8
# Layers beginning so far below, nats, get this fraction of the usual number of sequences.
FAR_SHARE, FAR = 1 / 3, 12.0
# The sum over all is estimated for at most so many sequences; more would need the surrogate to be enumerated.
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
    """Results for all cases or those named; quick: three angles on a coarse grid."""
    if quick:
        few = Effort(nested=1, live_points=30, each=6)
        row = _case("C1, small", QUICK, 30.0, SMALL, few, executor, notify)
        return {"quick": True, "live_points": few.live_points, "cases": [row]}
    effort = Effort()
    cases = [
        _case(name, CASES[name], None, DEFAULT_SETTINGS, effort, executor, notify) for name in only or CASES
    ]
    return {"quick": False, "live_points": effort.live_points, "cases": cases}


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
    begun = time.process_time()
    answer = stacking_posterior(specimen, SEED, settings=settings, executor=executor, notify=notify)
    problem = stacking_problem(specimen, SEED, settings=settings, executor=executor)
    notify("nested sampling")
    drawn = answer.drawn
    chosen = _first_classes(canonical(drawn.sequences, problem.symmetries).representative, effort.nested)
    items = [
        (problem.grid_deg[drawn.sequences[i]], np.random.default_rng([SEED, i, 14]), effort.live_points)
        for i in chosen
    ]
    nested = run_items(_nested, problem.conditional, items, executor, batch_size=1)
    compared: list[Results] = [
        {
            "angles_deg": [float(angle) for angle in problem.grid_deg[drawn.sequences[i]]],
            "importance": round(float(drawn.log_evidence[i]), 4),
            "importance_error": round(float(drawn.conditionals.error[i]), 4),
            "nested": round(log_evidence, 4),
            "nested_error": round(error, 4),
        }
        for i, (log_evidence, error) in zip(chosen, nested, strict=True)
    ]
    row: Results = {
        "case": name,
        "enumerated": answer.enumerated,
        "log_evidence": answer.log_evidence_total,
        "unaccounted": answer.unaccounted,
        "compared": compared,
        "sum": None,
        "layers": [],
    }
    if answer.enumerated <= MOST_SUMMED:
        notify("all layers")
        row |= _summed(problem, effort)
    return row | {"processor_seconds_here": time.process_time() - begun}


def _first_classes(sequences: Array, n: int) -> list[int]:
    """Indices of the first n distinct sequences among (m, k)."""
    return sorted(np.unique(sequences, axis=0, return_index=True)[1].tolist())[:n]


def _nested(
    conditional: ConditionalPosterior, item: tuple[Array, np.random.Generator, int]
) -> tuple[float, float]:
    """Log evidence of a sequence (k,) degrees by nested sampling, and its error."""
    angles_deg, rng, live_points = item
    posterior = conditional.at(angles_deg[None])

    def log_likelihood(x: Array) -> Array:
        value = np.full(len(x), -np.inf)
        inside = np.isfinite(posterior.log_prior(x))
        if inside.any():
            value[inside] = posterior.log_likelihood(x[inside])
        return value

    return nested_of_scores(
        log_likelihood,
        conditional.axes,
        conditional.parameters.size,
        rng,
        live_points=live_points,
    )


def summary(rows: list[Results]) -> Results:
    """Differences of log evidences in nats, and their rms corrected for nested sampling's own error.

    rms_at_most : that rms with its square enlarged by two standard errors.
    """
    miss = np.array([row["importance"] - row["nested"] for row in rows])
    error = np.array([row["nested_error"] for row in rows])
    left = float(np.mean(miss**2 - error**2))
    return {
        "compared": len(rows),
        "mean": float(miss.mean()),
        "mean_error": float(np.sqrt(np.sum(error**2)) / len(rows)),
        "rms": float(np.sqrt(np.mean(miss**2))),
        "nested_rms": float(np.sqrt(np.mean(error**2))),
        "rms_left": float(np.sqrt(max(left, 0.0))),
        "rms_at_most": float(np.sqrt(max(left + 2.0 * np.sqrt(2.0 * np.sum(error**4)) / len(rows), 0.0))),
        "largest": float(np.abs(miss).max()),
    }


def _summed(problem: StackingProblem, effort: Effort) -> Results:
    """Sum over all sequences, estimated layer by layer by ratio estimates."""
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
    library = scan_library(problem.conditional, LIBRARY, np.random.default_rng([SEED, 77]))
    rows = []
    for low, high in pairwise(LAYERS):
        own = np.flatnonzero((below >= low) & (below < high))
        if not len(own):
            continue
        drawn = effort.each if low < FAR else round(FAR_SHARE * effort.each)
        pick = np.sort(pick_rng.choice(own, size=min(drawn, len(own)), replace=False))
        found = evaluate(
            problem.conditional,
            problem.grid_deg,
            sequences[pick],
            problem.starts,
            LAYER_POINTS,
            problem.executor,
            library,
            scanned=STARTS,
        )
        nearest = known[pick].max()  # relative to the best drawn: far below the maximum exp would underflow
        value = size[pick] * np.exp(found.log_evidence - nearest)
        expected = size[pick] * np.exp(known[pick] - nearest)
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
    heads = ("case", "compared", "mean", "rms", "of nested sampling", "left", "largest", "log Z", "by layers")
    rows = tuple(
        (
            c["case"],
            str(of["compared"]),
            f"{of['mean']:+.3f}({of['mean_error']:.3f})",
            f"{of['rms']:.3f}",
            f"{of['nested_rms']:.3f}",
            f"{of['rms_left']:.3f}",
            f"{of['largest']:.2f}",
            f"{c['log_evidence']:.4f}",
            "-" if c["sum"] is None else f"{c['sum']['log_evidence']:.4f}({c['sum']['relative_error']:.4f})",
        )
        for c in results["cases"]
        for of in [summary(c["compared"])]
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
    """Section of docs/unknown_angles.md on errors of log evidences."""
    cases = [(c["case"], c["compared"]) for c in results["cases"]]
    if len(cases) > 1:
        cases.append(("all", [row for _, rows in cases for row in rows]))
    head = ("list", "stacking sequences", "mean", "excess rms", "its upper limit")
    rows = (
        (
            name,
            str(of["compared"]),
            f"{of['mean']:+.3f} ± {of['mean_error']:.3f}",
            f"{of['rms_left']:.3f}",
            f"{of['rms_at_most']:.2f}",
        )
        for name, compared in cases
        for of in [summary(compared)]
    )
    table = markdown_table(head, rows)
    every = summary(cases[-1][1])
    if abs(every["mean"]) <= 2.0 * every["mean_error"]:
        return {"errors": table}
    return {
        "errors": f"{table}\n\n"
        + paragraph("An error common to all sequences cancels in their probabilities.")
    }


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
