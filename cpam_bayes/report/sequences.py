"""Screen and document of `sequence`: what the frequencies say about the plies."""

from __future__ import annotations

from typing import Any

import numpy as np

from cpam_bayes.inference.sequences import SequenceAnswer
from cpam_bayes.measurement import to_user, user_name
from cpam_bayes.posterior import NOISE
from cpam_bayes.report.documents import plate_keys
from cpam_bayes.report.numbers import fixed, significant
from cpam_bayes.report.plates import plate_head
from cpam_bayes.report.tables import Column, Table, facts, remarks

__all__ = ["sequence_document", "sequence_screen", "sequence_warnings"]

_SHOWN = 12
# Errors of the learned evidence and of an exact one that a reader should hear of, nats.
_ROUGH, _DOUBTFUL = 0.3, 0.3


def sequence_warnings(result: SequenceAnswer) -> tuple[str, ...]:
    """Everything that is a reason not to trust the probabilities as they stand."""
    found = []
    check = result.check
    if check is not None and check.rms > _ROUGH:
        found.append(
            f"the learned log evidence is {check.rms:.2f} off (root mean square over draws from the "
            "posterior): the number of sequences in the credible set and the marginals are rough; the "
            "evidences of the sequences listed are computed, not learned"
        )
    if result.unaccounted > 1e-3:
        found.append(
            f"sequences with up to {result.unaccounted:.2g} of the probability were left out of the sums"
        )
    worst = float(result.log_evidence_error.max())
    if worst > _DOUBTFUL:
        found.append(f"the log evidence of a listed sequence is uncertain by {worst:.2f}")
    return tuple(found)


def sequence_document(
    result: SequenceAnswer, seed: int, top: int, warnings: tuple[str, ...]
) -> dict[str, Any]:
    """The JSON document of `sequence`."""
    check = result.check
    return {
        **plate_keys("sequence", result.specimen, seed),
        "enumerated": result.enumerated,
        "classes": result.classes,
        "symmetries": [s.name for s in result.symmetries],
        "angle_grid_deg": result.grid_deg.tolist(),
        "log_evidence": result.log_evidence_total,
        "sequences": [_sequence(result, i) for i in range(min(top, len(result.top)))],
        "credible_95_count": result.credible_count,
        "effective_count": result.effective_count,
        "unaccounted_probability": result.unaccounted,
        "angle_marginals": result.marginals.tolist(),
        "constants": _constants(result),
        "learned": None
        if check is None
        else {
            "from_sequences": check.learned_from,
            "rms_error_nats": check.rms,
            "largest_error_nats": check.largest,
            "correction_nats": check.correction,
            "effective_share": check.effective,
        },
        "seconds": result.seconds,
        "warnings": list(warnings),
        "notes": list(result.specimen.notes),
    }


def _sequence(result: SequenceAnswer, i: int) -> dict[str, Any]:
    x = result.components.conditionals.mean[i]
    names = result.own.parameters.names
    return {
        "angles_deg": result.top[i].tolist(),
        "probability": float(result.probability[i]),
        "equivalent": int(result.multiplicity[i]),
        "log_evidence": float(result.log_evidence[i]),
        "log_evidence_error": float(result.log_evidence_error[i]),
        "constants": {
            user_name(name): to_user(name, float(v))
            for name, v in zip(names, x, strict=True)
            if name != NOISE
        },
    }


def _constants(result: SequenceAnswer) -> dict[str, dict[str, float]]:
    """Mean and sd of the constants at the best fits of the sequences drawn, and at the most probable one."""
    found = {}
    for i, name in enumerate(result.own.parameters.names):
        if name == NOISE:
            continue
        unit = to_user(name, 1.0)
        mean, sd = weighted_moments(result, i)
        found[user_name(name)] = {"mean": unit * mean, "sd": unit * sd}
    return found


def weighted_moments(result: SequenceAnswer, i: int) -> tuple[float, float]:
    """Mean and sd of one constant over the mixture: within each sequence drawn and between them."""
    mean, sd = result.drawn.conditionals.mean[:, i], result.drawn.conditionals.sd[:, i]
    w = result.draw_weight
    centre = float(np.sum(w * mean))
    return centre, float(np.sqrt(np.sum(w * (sd**2 + (mean - centre) ** 2))))


def sequence_screen(result: SequenceAnswer, seed: int, warnings: tuple[str, ...]) -> tuple[Table, ...]:
    """Plate, the most probable sequences, plies, constants, how it was done."""
    return (
        plate_head(f"sequence {result.specimen.name}", result.specimen),
        _sequences(result),
        _plies(result),
        _mixture(result),
        _work(result, seed),
        remarks("Warnings", warnings, flagged=True),
    )


def _sequences(result: SequenceAnswer) -> Table:
    columns = (
        Column("rank", number=True),
        Column("unknown angles"),
        Column("probability of each", number=True),
        Column("equal to it", number=True),
        Column("log evidence", number=True),
        Column("+-", number=True),
    )
    rows = [
        (
            str(i + 1),
            "/".join(f"{a:g}" for a in result.top[i]),
            f"{result.probability[i]:.3g}",
            str(int(result.multiplicity[i]) - 1),
            fixed(float(result.log_evidence[i]), 2),
            fixed(float(result.log_evidence_error[i]), 2),
        )
        for i in range(min(_SHOWN, len(result.top)))
    ]
    return Table("Most probable sequences, images that no frequency tells apart merged", columns, tuple(rows))


def _plies(result: SequenceAnswer) -> Table:
    columns = (
        Column("unknown", number=True),
        Column("most probable angles and their probability"),
        Column("angles that hold 95 %", number=True),
    )
    rows = []
    for j, p in enumerate(result.marginals):
        order = np.argsort(-p, kind="stable")
        needed = int(np.searchsorted(np.cumsum(p[order]), 0.95)) + 1
        best = ", ".join(f"{result.grid_deg[a]:g} ({p[a]:.2f})" for a in order[:4])
        rows.append((str(j + 1), best, f"{needed} of {len(p)}"))
    return Table("Angle by angle, from the bottom", columns, tuple(rows))


def _mixture(result: SequenceAnswer) -> Table:
    columns = (
        Column("name"),
        Column("mean", number=True),
        Column("sd", number=True),
        Column("given the first sequence", number=True),
        Column("reference", number=True),
    )
    rows = []
    reference = result.specimen.material.constants
    for i, name in enumerate(result.own.parameters.names):
        if name == NOISE:
            continue
        unit = to_user(name, 1.0)
        mean, sd = weighted_moments(result, i)
        rows.append(
            (
                user_name(name),
                significant(unit * mean, 3),
                significant(unit * sd, 2),
                significant(unit * float(result.components.conditionals.mean[0, i]), 3),
                significant(unit * float(reference[name]), 3) if name in reference else "",
            )
        )
    return Table("Constants over all sequences", columns, tuple(rows))


def _work(result: SequenceAnswer, seed: int) -> Table:
    images = ", ".join(s.name for s in result.symmetries) or "none"
    rows = [
        ("sequences", f"{result.enumerated} on the grid of {result.specimen.angle_grid_deg:g} degrees"),
        ("layup", result.specimen.plate.layup.text),
        ("symmetries", images),
        ("95 % set", f"{result.credible_count} sequences"),
        ("effective number", f"{significant(result.effective_count, 3)} sequences, exp of the entropy"),
        ("left out", f"{result.unaccounted:.1g} of the probability at most"),
    ]
    if result.check is not None:
        c = result.check
        rows.append(
            (
                "learned",
                f"from {c.learned_from} sequences; off by {c.rms:.2f} (rms) and {c.largest:.2f} (most) in "
                "log evidence on draws from the result, which correct its sum",
            )
        )
    rows.append(("work", f"{result.seconds:.0f} s, seed {seed}"))
    return facts("All sequences", tuple(rows))
