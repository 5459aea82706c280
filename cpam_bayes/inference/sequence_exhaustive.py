"""The posterior over few stacking sequences: the evidence of each one is computed."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from cpam_bayes.inference.sequence_answer import CREDIBLE, SequenceAnswer, Task, moved
from cpam_bayes.inference.sequence_classes import canonical
from cpam_bayes.inference.sequence_evaluation import evaluate


def exhaustive(task: Task, rng: np.random.Generator, notify: Callable[[str], None]) -> SequenceAnswer:
    """Every evidence computed."""
    g, k = len(task.grid_deg), task.n_unknown
    every = np.stack(np.unravel_index(np.arange(g**k), (g,) * k), axis=1)
    orbits = canonical(every, task.symmetries)
    code = orbits.representative @ (g ** np.arange(k - 1, -1, -1))
    _, first, label = np.unique(code, return_index=True, return_inverse=True)
    representative, size = orbits.representative[first], orbits.size[first]
    notify(f"evidence of {len(first)} sequences")
    data = evaluate(
        task.own, task.grid_deg, representative, task.starts, task.settings.log2_points, task.executor
    )
    total = float(np.log(np.sum(size * np.exp(data.log_evidence - data.log_evidence.max()))))
    total += float(data.log_evidence.max())
    single = np.exp(data.log_evidence - total)
    p = single[label.ravel()]
    marginals = np.stack([np.bincount(every[:, j], p, minlength=g) for j in range(k)])
    order = np.argsort(-single, kind="stable")
    held = np.cumsum(np.repeat(single[order], size[order]))
    drawn = rng.choice(len(first), size=task.settings.draws, p=single * size / np.sum(single * size))
    top = order[: task.settings.listed]
    positive = single > 0
    return SequenceAnswer(
        specimen=task.specimen,
        own=task.own,
        symmetries=task.symmetries,
        grid_deg=task.grid_deg,
        enumerated=g**k,
        classes=len(first),
        log_evidence_total=total - float(np.log(g**k)),
        top=task.grid_deg[representative[top]],
        multiplicity=size[top],
        probability=single[top],
        log_evidence=data.log_evidence[top],
        log_evidence_error=data.conditionals.error[top],
        components=data[top],
        marginals=marginals,
        credible_count=int(np.searchsorted(held, CREDIBLE) + 1),
        effective_count=float(np.exp(-np.sum(size * single * np.log(np.where(positive, single, 1.0))))),
        unaccounted=0.0,
        drawn=moved(task, data[drawn], rng),
        draw_weight=np.full(len(drawn), 1.0 / len(drawn)),
        check=None,
        seconds=0.0,
    )
