"""`sequence` in plain words: which stacking sequences the frequencies leave, and how sure each angle is."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from cpam_bayes.formatting import probable, significant
from cpam_bayes.identification.scale_errors import thin_plate_errors
from cpam_bayes.identification.verdicts import verdict_of
from cpam_bayes.inference.posterior import NOISE
from cpam_bayes.plate import to_user, unit_of, user_name
from cpam_bayes.plate.units import USER_UNITS
from cpam_bayes.report.sentences import (
    DETERMINED,
    attached_step,
    constant_title,
    contained_sentence,
    decider,
    frequencies_text,
    noise_sentence,
    plate_sentence,
    reliance_sentences,
    rests_on,
    scale_sentences,
)
from cpam_bayes.report.summary import ConstantLine, Summary
from cpam_bayes.report.tables import Table, headed
from cpam_bayes.stacking.sequence import StackingResult

# Stacking sequences on the first screen.
_SHOWN: Final = 5
# Sequences in the 95 % set, and probability of the first, from which the layup is called determined.
_SURE: Final = 0.95
# Probability of an angle that is worth a place on the screen.
_SHOWN_PROBABILITY: Final = 0.05


def summary(result: StackingResult) -> Summary:
    """The stacking sequences, the constants over all of them, what both rest on, and what to do next."""
    constants = _constants(result)
    use = [c.symbol for c in constants if c.determined != "no"]
    return Summary(
        title=f"sequence {result.title}",
        slips=result.slips,
        headline=_headline(result),
        constants=constants,
        tables=(_sequences(result), _angles(result)),
        basis=_basis(result, use),
        warnings=tuple(w for w in result.warnings if w not in result.slips),
        next_steps=_next_steps(result, use),
    )


def _headline(result: StackingResult) -> str:
    answer = result.answer
    first = "/".join(f"{a:g}" for a in answer.top[0])
    together = float(answer.probability[0] * answer.multiplicity[0])
    equal = int(answer.multiplicity[0]) - 1
    images = f" or {equal} more with the same frequencies" if equal else ""
    if together >= _SURE:
        return f"The frequencies determine the unknown angles: {first}{images}, probability {together:.3g}."
    return (
        f"The frequencies do not determine one stacking sequence: {answer.credible_count} of "
        f"{answer.enumerated} hold 95 % of the probability. The most probable one is {first}{images}, "
        f"probability {together:.2g}."
    )


def _sequences(result: StackingResult) -> Table:
    answer = result.answer
    columns = headed(
        "#rank", "unknown angles, from the bottom", "#probability", "#others with the same frequencies"
    )
    rows = tuple(
        (
            str(i + 1),
            "/".join(f"{a:g}" for a in answer.top[i]),
            probable(float(answer.probability[i] * answer.multiplicity[i])),
            str(int(answer.multiplicity[i]) - 1),
        )
        for i in range(min(_SHOWN, len(answer.top)))
    )
    return Table("Most probable stacking sequences", columns, rows)


def _angles(result: StackingResult) -> Table:
    answer, information = result.answer, result.information
    columns = headed(
        "#unknown angle, outermost first", "most probable, with probability", "#angles that hold 95 %"
    )
    rows = []
    for number, j in enumerate(information.outer_first, 1):
        p = answer.marginals[j]
        order = np.argsort(-p, kind="stable")
        needed = int(np.searchsorted(np.cumsum(p[order]), 0.95)) + 1
        best = ", ".join(
            f"{answer.grid_deg[a]:g} ({p[a]:.2f})" for a in order[:4] if p[a] >= _SHOWN_PROBABILITY
        )
        rows.append((str(number), best or "no angle stands out", f"{needed} of {len(p)}"))
    return Table("Angle by angle", columns, tuple(rows))


def _constants(result: StackingResult) -> tuple[ConstantLine, ...]:
    conditional, draws = result.answer.conditional, result.mixture.parameters
    reference = result.specimen.material.constants
    lines = []
    for i, name in enumerate(conditional.parameters.names):
        if name == NOISE or user_name(name) not in USER_UNITS or name not in result.specimen.unknowns.names:
            continue
        unit, prior = to_user(name, 1.0), conditional.parameters[name].prior
        low, high = np.quantile(draws[:, i], (0.025, 0.975))
        verdict = verdict_of(float(draws[:, i].std()), prior.sd, explained=result.explained)
        lines.append(
            ConstantLine(
                symbol=name,
                title=constant_title(name, result.specimen.material),
                key=user_name(name),
                value=unit * float(draws[:, i].mean()),
                interval=(unit * float(low), unit * float(high)),
                unit=unit_of(name),
                reference=unit * float(reference.get(name, np.nan)),
                determined=DETERMINED[verdict],
                by=decider(verdict, name, prior),
                rests_on=rests_on(name, result.reliances, lambda other: conditional.parameters[other].prior),
            )
        )
    return tuple(lines)


def _unseen(result: StackingResult, use: Sequence[str]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    errors = thin_plate_errors(result.specimen)
    return scale_sentences(
        result.specimen, errors, [name for name in use if name in errors[0].shift], counted=False
    )


def _basis(result: StackingResult, use: Sequence[str]) -> tuple[str, ...]:
    """What the answer rests on; use : the constants that the frequencies have a say in."""
    answer, fit = result.answer, result.fit
    parameters = answer.conditional.parameters
    template = answer.conditional.template
    residual = np.asarray(fit.residual)[np.isfinite(fit.residual)]
    rms = float(np.sqrt(np.mean(residual**2))) if residual.size else np.nan
    source = "inferred from the misfit" if template.noise_is_inferred else "from the plate file"
    return (
        f"Every one of the {answer.enumerated} sequences on the grid of {answer.specimen.angle_grid_deg:g} "
        "degrees is equally probable before the measurement.",
        f"With the most probable sequence the plate model repeats the "
        f"{frequencies_text(template.measurement.size)} to {significant(100 * rms, 2)} % (root mean square).",
        noise_sentence(fit.noise, f"the level is {source}"),
        plate_sentence(result.specimen),
        "Stacking sequences with the same bending stiffness have the same frequencies: no number of "
        "frequencies tells a layup from its mirror images.",
        contained_sentence(result.specimen.plate, counted=False),
        *_unseen(result, use)[0],
        *reliance_sentences(result.reliances, lambda name: parameters[name].prior, use),
    )


def _next_steps(result: StackingResult, use: Sequence[str]) -> tuple[str, ...]:
    """What costs nothing first."""
    answer = result.answer
    steps = [*attached_step(result.specimen)]
    if answer.probability[0] * answer.multiplicity[0] < _SURE:
        steps.append(
            'Narrow the choice with what is known of the layup: write known angles instead of "?", take a '
            "coarser angle_grid_deg, or give narrower bounds of the constants from a tensile test."
        )
    steps += _unseen(result, use)[1]
    if answer.probability[0] * answer.multiplicity[0] < _SURE:
        steps.append("Measure more modes, and give relative_std in [measurement] from repeated tap tests.")
    return tuple(steps)
