"""Screen and document of `sequence`: what the frequencies say about the plies."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.formatting import NOT_KNOWN, decimals_of, fixed, signed, significant, with_spread
from cpam_bayes.inference.posterior import NOISE
from cpam_bayes.plate import Specimen, to_user, user_name
from cpam_bayes.report.documents import plate_keys
from cpam_bayes.report.plates import air_text, plate_head
from cpam_bayes.report.tables import Column, Table, facts, remarks
from cpam_bayes.stacking.mixture import SampledComponent, StackingMixture
from cpam_bayes.stacking.posterior import OVERLOOKED, StackingPosterior
from cpam_bayes.stacking.queries.angle_information import AngleInformation, angle_information
from cpam_bayes.stacking.queries.best_fit import BestFit, best_fit
from cpam_bayes.stacking.queries.given_layup import GivenLayup

__all__ = ["outer_and_inner", "sequence_document", "sequence_screen", "sequence_warnings"]

_SHOWN = 12
# Probability of an angle that is worth a place on the screen, beside the most probable one.
_SHOWN_SHARE = 0.005
# Errors of the learned evidence and of an exact one that a reader should hear of, nats.
_ROUGH, _DOUBTFUL = 0.3, 0.3
# Share of the probability of the first from which on an uncertain evidence matters.
_COUNTS = 1e-3
# No sequence explains a list whose residuals have a smaller probability by noise alone, or whose noise, where
# it is inferred, is larger, relative.
_UNEXPLAINED, _NOISY = 1e-3, 0.05
# Difference of emcee and importance sampling that a reader should hear of, in standard errors: the largest
# of a hundred moments of each of twenty classes exceeds it once in hundreds of times.
_DISAGREE = 5.0


def sequence_warnings(result: StackingPosterior, mixture: StackingMixture) -> tuple[str, ...]:
    """Everything that is a reason not to trust the probabilities as they stand."""
    found = list(_misfits(result, best_fit(result)))
    if result.specimen.plate.sd:
        found.append("[plate.sd] is not counted with: sizes, density and mass are taken as exact")
    check = result.check
    if check is not None and check.rms > _ROUGH:
        found.append(
            f"the learned log evidence is {check.rms:.2f} off (root mean square over draws from the "
            "posterior): the number of sequences in the credible set and the marginals are rough; the "
            "evidences of the sequences listed are computed, not learned"
        )
    if check is not None and check.overlooked > OVERLOOKED:
        found.append(
            f"a sequence drawn from the posterior is better by {check.overlooked:.1f} in log evidence than "
            "every one listed: the list of the most probable sequences is not complete"
        )
    if result.unaccounted > 1e-3:
        found.append(
            f"sequences with up to {result.unaccounted:.2g} of the probability were left out of the sums"
        )
    counts = result.probability * result.multiplicity > _COUNTS * result.probability[0]
    doubtful = np.flatnonzero(counts & (result.log_evidence_error > _DOUBTFUL))
    if len(doubtful):
        found.append(
            f"the log evidence of {len(doubtful)} listed sequences is uncertain by up to "
            f"{result.log_evidence_error[doubtful].max():.2f}, first number {doubtful[0] + 1}"
        )
    for c in mixture.sampled:
        name = f"the chains of sequence {c.index + 1}" if c.index >= 0 else "the chains of the given sequence"
        if not c.diagnostics.converged:
            found.append(
                f"{name} have not converged: R-hat {c.diagnostics.r_hat:.3f}, "
                f"{c.diagnostics.ess_bulk:.0f} effective samples"
            )
        if c.worst_z > _DISAGREE:
            found.append(
                f"{name} and importance sampling differ by {c.worst_z:.1f} standard errors in a mean or an sd"
            )
    return tuple(found)


def _misfits(result: StackingPosterior, fit: BestFit) -> tuple[str, ...]:
    """What the fit of the most probable sequence says against all of them."""
    found = []
    measurement = result.conditional.template.measurement
    advice = "check the list, the plate and the bounds, or ask `diagnose` with a layup that you believe in"
    if measurement.complete:
        advice = f"a mode may be missing (complete = false); {advice}"
    if fit.p_value is not None and fit.p_value < _UNEXPLAINED:
        found.append(
            "no sequence explains the list: noise as stated leaves residuals like those of the most probable "
            f"one with probability {fit.p_value:.1g}; {advice}"
        )
    alone = int(np.isnan(fit.predicted).sum())
    if alone:
        found.append(
            f"{alone} of the {len(fit.predicted)} frequencies belong to no mode of the most probable "
            f"sequence; {advice}"
        )
    if result.conditional.template.noise_is_inferred and fit.noise > _NOISY:
        found.append(
            f"no sequence explains the list well: the noise inferred is {100 * fit.noise:.2g} %; {advice}"
        )
    if fit.bounds:
        ends = ", ".join(f"{user_name(name)} at its {which} bound" for name, which in fit.bounds)
        found.append(f"given the most probable sequence, {ends}")
    return tuple(found)


def sequence_document(
    result: StackingPosterior,
    mixture: StackingMixture,
    given: GivenLayup | None,
    seed: int,
    top: int,
    warnings: tuple[str, ...],
) -> dict[str, Any]:
    """The JSON document of `sequence`; given : the sequence printed for a specimen of the paper."""
    check, fit = result.check, best_fit(result)
    information = angle_information(result.specimen.plate.layup, result.marginals)
    return {
        **plate_keys("sequence", result.specimen, seed),
        "enumerated": result.enumerated,
        "classes": result.classes,
        "symmetries": [s.name for s in result.symmetries],
        "angle_grid_deg": result.grid_deg.tolist(),
        "log_evidence": result.log_evidence_total,
        "sequences": [_sequence(result, mixture, i) for i in range(min(top, len(result.top)))],
        "credible_95_count": result.credible_count,
        "effective_count": result.effective_count,
        "unaccounted_probability": result.unaccounted,
        "angle_marginals": result.marginals.tolist(),
        "angle_entropy_bits": np.abs(information.entropy_bits).tolist(),
        "angle_entropy_most_bits": information.most_bits,
        "outer_plies_better_determined": information.outer_better,
        "constants": _constants(result, mixture),
        "mixture": {
            "draws": len(mixture.parameters),
            "sampled_by_emcee": len(mixture.components),
            "probability_by_emcee": mixture.emcee_fraction,
            "probability_by_importance_sampling": mixture.listed_fraction,
            "probability_by_drawn_sequences": mixture.drawn_fraction,
            "converged": mixture.converged,
            "worst_difference_in_standard_errors": max((c.worst_z for c in mixture.sampled), default=None),
            "seconds": mixture.seconds,
        },
        "frequencies": _frequencies_document(result, fit),
        "missed_modes": [{"predicted_hz": float(f)} for f in fit.missed],
        "p_value": fit.p_value,
        "noise_percent": 100.0 * fit.noise,
        "noise_inferred": result.conditional.template.noise_is_inferred,
        "printed_sequence": None if given is None else _given(result, mixture, given),
        "learned": None
        if check is None
        else {
            "from_sequences": check.training_size,
            "rms_error_nats": check.rms,
            "largest_error_nats": check.largest,
            "overlooked_nats": check.overlooked,
            "correction_nats": check.correction,
            "effective_share": check.effective,
        },
        "seconds": result.seconds,
        "warnings": list(warnings),
        "notes": list(result.specimen.notes),
    }


def _sequence(result: StackingPosterior, mixture: StackingMixture, i: int) -> dict[str, Any]:
    if i < len(mixture.components):
        mean, sd, by = mixture.components[i].chains.mean, mixture.components[i].chains.sd, "emcee"
    else:
        own = result.components.conditionals
        mean, sd, by = own.mean[i], own.sd[i], "importance sampling"
    return {
        "angles_deg": result.top[i].tolist(),
        "probability": float(result.probability[i]),
        "equivalent": int(result.multiplicity[i]),
        "same_bending_deg": result.grid_deg[result.same_bending[i]].tolist(),
        "log_evidence": float(result.log_evidence[i]),
        "log_evidence_error": float(result.log_evidence_error[i]),
        "constants": _by_name(result, mean),
        "constants_sd": _by_name(result, sd),
        "sampled_by": by,
    }


def _by_name(result: StackingPosterior, values: NDArray[Any]) -> dict[str, float]:
    return {
        user_name(name): to_user(name, float(v))
        for name, v in zip(result.conditional.parameters.names, values, strict=True)
        if name != NOISE
    }


def _given(result: StackingPosterior, mixture: StackingMixture, given: GivenLayup) -> dict[str, Any]:
    own = mixture.given
    return {
        "angles_deg": given.angles_deg.tolist(),
        "probability": given.probability,
        "rank": given.rank,
        "log_evidence": given.log_evidence,
        "log_evidence_error": given.log_evidence_error,
        "constants": None if own is None else _by_name(result, own.chains.mean),
        "constants_sd": None if own is None else _by_name(result, own.chains.sd),
    }


def _constants(result: StackingPosterior, mixture: StackingMixture) -> dict[str, dict[str, float]]:
    """Mean, sd and quantiles of the constants over the mixture's draws."""
    found = {}
    for i, name in enumerate(result.conditional.parameters.names):
        if name == NOISE:
            continue
        x = mixture.parameters[:, i] * to_user(name, 1.0)
        q025, q975 = np.quantile(x, (0.025, 0.975))
        found[user_name(name)] = {
            "mean": float(x.mean()),
            "sd": float(x.std()),
            "q025": float(q025),
            "q975": float(q975),
        }
    return found


def sequence_screen(
    result: StackingPosterior,
    mixture: StackingMixture,
    given: GivenLayup | None,
    seed: int,
    warnings: tuple[str, ...],
) -> tuple[Table, ...]:
    """Plate, the most probable sequences, plies, constants, how it was done."""
    information = angle_information(result.specimen.plate.layup, result.marginals)
    fit = best_fit(result)
    return (
        plate_head(f"sequence {result.specimen.name}", result.specimen, air_text(_most_probable(result))),
        _sequences(result),
        _plies(result, information),
        remarks("Outer and inner plies", (outer_and_inner(information),)),
        *_fit(result, fit),
        _mixture(result, mixture, given),
        _work(result, mixture, given, seed, fit),
        remarks("Warnings", warnings, flagged=True),
    )


def _most_probable(result: StackingPosterior) -> Specimen:
    """The specimen with the most probable angles."""
    plate = result.specimen.plate
    return replace(result.specimen, plate=replace(plate, layup=plate.layup.with_angles(result.top[0])))


def _sequences(result: StackingPosterior) -> Table:
    columns = (
        Column("rank", number=True),
        Column("unknown angles"),
        Column("probability of each", number=True),
        Column("of", number=True),
        Column("together", number=True),
        Column("log evidence", number=True),
        Column("+-", number=True),
    )
    rows = [
        (
            str(i + 1),
            "/".join(f"{a:g}" for a in result.top[i]),
            f"{result.probability[i]:.3g}",
            str(int(result.multiplicity[i])),
            f"{result.probability[i] * result.multiplicity[i]:.3g}",
            fixed(float(result.log_evidence[i]), 2),
            fixed(float(result.log_evidence_error[i]), 2),
        )
        for i in range(min(_SHOWN, len(result.top)))
    ]
    return Table("Most probable sequences, those that no frequency tells apart merged", columns, tuple(rows))


def _plies(result: StackingPosterior, information: AngleInformation) -> Table:
    columns = (
        Column("unknown", number=True),
        Column("most probable angles and their probability"),
        Column("angles that hold 95 %", number=True),
        Column("entropy, bits", number=True),
        Column("share of D, %", number=True),
    )
    rows = []
    for j, p in enumerate(result.marginals):
        order = np.argsort(-p, kind="stable")
        needed = int(np.searchsorted(np.cumsum(p[order]), 0.95)) + 1
        best = ", ".join(f"{result.grid_deg[a]:g} ({p[a]:.2f})" for a in order[:4] if p[a] >= _SHOWN_SHARE)
        bits, share = information.entropy_bits[j], information.bending_fraction[j]
        rows.append((str(j + 1), best, f"{needed} of {len(p)}", f"{abs(bits):.2f}", f"{100 * share:.1f}"))
    return Table("Angle by angle, from the bottom", columns, tuple(rows))


def outer_and_inner(information: AngleInformation) -> str:
    """Whether the list tells more about the outer plies, in one sentence."""
    bits = information.entropy_bits[information.outer_first]
    listed = ", ".join(f"{abs(b):.2f}" for b in bits)
    if len(bits) < 2:
        return f"one unknown angle: {listed} bits of {information.most_bits:.2f} are left open"
    verdict = "outer angles are not throughout better determined than inner ones"
    if information.outer_better:
        verdict = "outer angles are better determined than inner ones"
    return (
        f"{verdict}: entropy from the outermost in {listed} of {information.most_bits:.2f} bits; equally "
        "probable mirror images count 1 bit"
    )


def _fit(result: StackingPosterior, fit: BestFit) -> tuple[Table, ...]:
    """The list beside the most probable sequence, and what of its modes the list lacks."""
    measured = result.conditional.template.measurement.frequencies
    columns = tuple(Column(h, number=True) for h in ("measured Hz", "predicted Hz", "residual %"))
    decimals = decimals_of(measured)
    rows = tuple(
        (fixed(float(f), decimals), NOT_KNOWN, NOT_KNOWN)
        if np.isnan(p)
        else (fixed(float(f), decimals), fixed(float(p), decimals + 1), signed(100 * float(r), 2))
        for f, p, r in zip(measured, fit.predicted, fit.residual, strict=True)
    )
    lacks = ", ".join(fixed(float(f), decimals + 1) for f in fit.missed)
    return (
        Table("The list and the most probable sequence", columns, rows),
        remarks("The list lacks", (f"modes of the most probable sequence at {lacks} Hz",) if lacks else ()),
    )


def _noise(result: StackingPosterior, fit: BestFit) -> str:
    """What noise the probabilities stand on, and how well the first sequence fits with it."""
    level = f"{significant(100 * fit.noise, 2)} % of a frequency"
    if result.conditional.template.noise_is_inferred:
        return f"{level}, inferred, given the most probable sequence"
    said = f"{level}, from the plate file"
    if fit.p_value is None:
        return said
    return f"{said}; alone it leaves residuals like these or larger with probability {fit.p_value:.2g}"


def _frequencies_document(result: StackingPosterior, fit: BestFit) -> list[dict[str, float | None]]:
    measured = result.conditional.template.measurement.frequencies
    return [
        {
            "measured_hz": float(f),
            "predicted_hz": None if np.isnan(p) else float(p),
            "residual_percent": None if np.isnan(p) else 100.0 * float(r),
        }
        for f, p, r in zip(measured, fit.predicted, fit.residual, strict=True)
    ]


def _mixture(result: StackingPosterior, mixture: StackingMixture, given: GivenLayup | None) -> Table:
    first: SampledComponent | None = mixture.components[0] if mixture.components else None
    columns = (
        Column("name"),
        Column("mean", number=True),
        Column("sd", number=True),
        Column("given the first sequence", number=True),
        Column("sd", number=True),
        *((Column("given the printed one", number=True), Column("sd", number=True)) if given else ()),
        Column("reference", number=True),
    )
    rows = []
    reference = result.specimen.material.constants
    for i, name in enumerate(result.conditional.parameters.names):
        if name == NOISE:
            continue
        unit = to_user(name, 1.0)
        cells = [user_name(name)]
        moments = [(mixture.parameters[:, i].mean(), mixture.parameters[:, i].std())]
        moments.append((first.chains.mean[i], first.chains.sd[i]) if first else (np.nan, np.nan))
        if given and mixture.given:
            moments.append((mixture.given.chains.mean[i], mixture.given.chains.sd[i]))
        for mean, sd in moments:
            cells += with_spread(unit * float(mean), unit * float(sd))
        cells.append(significant(unit * float(reference[name])) if name in reference else "")
        rows.append(tuple(cells))
    return Table("Constants over all sequences", columns, tuple(rows))


def _work(
    result: StackingPosterior,
    mixture: StackingMixture,
    given: GivenLayup | None,
    seed: int,
    fit: BestFit,
) -> Table:
    images = ", ".join(s.name for s in result.symmetries) or "none"
    rows = [
        ("sequences", f"{result.enumerated} on the grid of {result.specimen.angle_grid_deg:g} degrees"),
        ("layup", result.specimen.plate.layup.text),
        ("noise", _noise(result, fit)),
        ("symmetries", images),
        *_same_bending(result),
        *_printed(result, given),
        ("95 % set", f"{result.credible_count} sequence" + ("s" if result.credible_count > 1 else "")),
        ("effective number", f"{significant(result.effective_count, 3)} sequences, exp of the entropy"),
        ("left out", f"{result.unaccounted:.1g} of the probability at most"),
        (
            "constants",
            f"emcee on the first {len(mixture.components)} of the list, "
            f"{100 * mixture.emcee_fraction:.1f} % of the probability; importance sampling on the rest",
        ),
    ]
    if result.check is not None:
        c = result.check
        rows.append(
            (
                "learned",
                f"from {c.training_size} sequences; off by {c.rms:.2f} (rms) and {c.largest:.2f} (most) in "
                "log evidence on draws from the result, which correct its sum",
            )
        )
    rows.append(
        ("work", f"{result.seconds:.0f} s and {mixture.seconds:.0f} s for the constants, seed {seed}")
    )
    return facts("All sequences", tuple(rows))


def _printed(result: StackingPosterior, given: GivenLayup | None) -> tuple[tuple[str, str], ...]:
    """The sequence printed for a specimen of the paper among all."""
    if given is None:
        return ()
    place = f"number {given.rank}" if given.rank else f"not among the first {len(result.top)}"
    angles = "/".join(f"{a:g}" for a in given.angles_deg)
    return (("printed", f"{angles}: probability {given.probability:.3g}, {place}"),)


def _same_bending(result: StackingPosterior) -> tuple[tuple[str, str], ...]:
    """Listed sequences that share their bending stiffness with others that are no images of them."""
    several = [i for i, others in enumerate(result.same_bending) if len(others)]
    if not several:
        return ()
    merged = sum(len(result.alike[i]) > 0 for i in several)
    one, other = result.top[several[0]], result.grid_deg[result.same_bending[several[0]][0]]
    names = " and ".join("/".join(f"{a:g}" for a in angles) for angles in (one, other))
    said = f"{len(several)} of {len(result.top)} listed have it in common with others, as {names}"
    return (("same bending", f"{said}; {merged} merged with them, as nothing else counts"),)
