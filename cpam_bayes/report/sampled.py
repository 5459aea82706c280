"""Screen and document of `identify --backend emcee`: a posterior and how far to trust its chains."""

from __future__ import annotations

from typing import Any

import numpy as np

from cpam_bayes.inference.sampled import ConstantPosterior, SampledIdentification
from cpam_bayes.measurement import to_user, user_name
from cpam_bayes.posterior import NOISE
from cpam_bayes.report.documents import laminate_unit, plate_keys
from cpam_bayes.report.numbers import decimals_of, fixed, significant, with_spread
from cpam_bayes.report.plates import plate_head, unit_of
from cpam_bayes.report.tables import Column, Table, facts, remarks

__all__ = ["sampled_document", "sampled_screen", "sampled_warnings"]

# A posterior predictive p-value this far out says that noise alone does not explain the residuals.
_P_LOW = 0.02


def sampled_warnings(result: SampledIdentification) -> tuple[str, ...]:
    """Everything that is a reason not to trust the numbers as they stand."""
    found = []
    measurement = result.posterior.measurement
    unknowns = result.posterior.model.parameters.size
    if measurement.size <= unknowns:
        found.append(f"{measurement.size} frequencies for {unknowns} unknowns: the prior decides")
    if result.result.status == "budget":
        d = result.result.diagnostics
        found.append(
            f"the chains used their budget of {d.steps} steps before they converged (R-hat "
            f"{d.r_hat:.3f}, {d.ess_bulk:.0f} effective samples): means and intervals are not reliable; "
            "allow more steps"
        )
    if result.p_value < _P_LOW:
        found.append(
            f"posterior predictive p-value {result.p_value:.3f}: the residuals are larger than the noise "
            "of the plate file explains, the plate model lacks something or the noise is larger"
        )
    return tuple(found)


def sampled_document(result: SampledIdentification, seed: int, warnings: tuple[str, ...]) -> dict[str, Any]:
    """The JSON document of `identify` by sampling."""
    d = result.result.diagnostics
    noise = [c for c in result.constants if c.name == NOISE]
    return {
        **plate_keys("identify", result.specimen, seed),
        "backend": "emcee",
        "status": result.result.status,
        "constants": {user_name(c.name): _marginal(c) for c in _constants(result)},
        "noise": _quantiles(noise[0], 1.0) if noise else None,
        "frequencies": _frequency_rows(result),
        "missed_modes": [
            {
                "predicted_hz": float(result.predicted[j]),
                "kind": result.modes[j].kind,
                "label": result.modes[j].label,
            }
            for j in result.pairing.missed
        ],
        "posterior_predictive_p_value": result.p_value,
        "relative_error_estimate": float(np.max(result.error)),
        "laminate": {
            laminate_unit(name)[0]: {
                "value": mean * laminate_unit(name)[1],
                "sd": sd * laminate_unit(name)[1],
            }
            for name, (mean, sd) in result.laminate.items()
        },
        "diagnostics": {
            "r_hat": d.r_hat,
            "ess_bulk": d.ess_bulk,
            "autocorrelation_time": d.autocorrelation_time,
            "converged": d.converged,
            "steps": d.steps,
            "burn_in": d.burn_in,
        },
        "air_density_kg_m3": result.specimen.air_density,
        "forward_solves": result.forward_solves,
        "seconds": result.seconds,
        "warnings": list(warnings),
        "notes": list(result.specimen.notes),
    }


def _constants(result: SampledIdentification) -> tuple[ConstantPosterior, ...]:
    return tuple(c for c in result.constants if c.name != NOISE)


def _quantiles(c: ConstantPosterior, factor: float) -> dict[str, float]:
    return {key: factor * float(getattr(c, key)) for key in ("mean", "sd", "q025", "median", "q975")}


def _marginal(c: ConstantPosterior) -> dict[str, Any]:
    return {
        **_quantiles(c, to_user(c.name, 1.0)),
        "prior_contraction": c.contraction,
        "share_at_lower_bound": c.at_lower,
        "share_at_upper_bound": c.at_upper,
        "lower": to_user(c.name, c.lower),
        "upper": to_user(c.name, c.upper),
        "verdict": c.verdict,
        "reference": to_user(c.name, c.reference),
    }


def _frequency_rows(result: SampledIdentification) -> list[dict[str, Any]]:
    rows = []
    for f, j in zip(result.posterior.measurement.frequencies, result.pairing.mode, strict=True):
        paired = j >= 0
        predicted = float(result.predicted[j]) if paired else None
        rows.append(
            {
                "measured_hz": float(f),
                "predicted_hz": predicted,
                "predicted_sd_hz": float(result.predicted_sd[j]) if paired else None,
                "residual_percent": None if predicted is None else 100.0 * (predicted / float(f) - 1.0),
                "kind": result.modes[j].kind if paired else None,
                "label": result.modes[j].label if paired else None,
            }
        )
    return rows


def sampled_screen(result: SampledIdentification, seed: int, warnings: tuple[str, ...]) -> tuple[Table, ...]:
    """Plate, marginal posteriors, what to believe of them, frequencies, chains."""
    return (
        plate_head(f"identify {result.specimen.name}", result.specimen),
        _marginals(result),
        remarks("What the frequencies determine", _verdicts(result)),
        _frequencies(result),
        _laminate(result),
        _chains(result, seed),
        remarks("Warnings", warnings, flagged=True),
    )


def _marginals(result: SampledIdentification) -> Table:
    columns = (
        Column("name"),
        Column("mean", number=True),
        Column("sd", number=True),
        Column("2.5 %", number=True),
        Column("97.5 %", number=True),
        Column("unit"),
        Column("reference", number=True),
        Column("prior"),
        Column("contraction", number=True),
        Column("verdict"),
    )
    rows = []
    for c in _constants(result):
        mean, sd = with_spread(to_user(c.name, c.mean), to_user(c.name, c.sd))
        low, high = (with_spread(to_user(c.name, q), to_user(c.name, c.sd))[0] for q in (c.q025, c.q975))
        bounds = f"{to_user(c.name, c.lower):.6g} to {to_user(c.name, c.upper):.6g}"
        reference = f"{to_user(c.name, c.reference):.6g}"
        rows.append(
            (
                c.name,
                mean,
                sd,
                low,
                high,
                unit_of(c.name),
                reference,
                bounds,
                fixed(c.contraction, 2),
                c.verdict,
            )
        )
    doubtful = frozenset(i for i, c in enumerate(_constants(result)) if c.verdict != "determined by the data")
    return Table("Constants, posterior", columns, tuple(rows), doubtful)


def _verdicts(result: SampledIdentification) -> tuple[str, ...]:
    found = []
    for c in _constants(result):
        if c.verdict == "determined by the prior":
            found.append(
                f"{c.name} is determined by the prior, not by the frequencies. Do not use its value."
            )
        if c.verdict == "at a bound":
            share, bound = max((c.at_lower, "lower"), (c.at_upper, "upper"))
            found.append(
                f"{c.name}: {100 * share:.0f} % of the draws lie at its {bound} bound; the bound has a say "
                "in it, and the other constants depend on it."
            )
    sure = [c.name for c in _constants(result) if c.verdict == "determined by the data"]
    return (*found, f"Determined by the frequencies: {', '.join(sure) or 'none of the constants'}.")


def _frequencies(result: SampledIdentification) -> Table:
    columns = (
        Column("mode", number=True),
        Column("label"),
        Column("kind"),
        Column("measured Hz", number=True),
        Column("predicted Hz", number=True),
        Column("sd", number=True),
        Column("residual %", number=True),
    )
    decimals = decimals_of(result.posterior.measurement.frequencies)
    rows = []
    for f, j in zip(result.posterior.measurement.frequencies, result.pairing.mode, strict=True):
        if j < 0:
            rows.append(("-", "", "no mode", fixed(float(f), decimals), "", "", ""))
            continue
        mode, predicted = result.modes[j], float(result.predicted[j])
        residual = fixed(100 * (predicted / float(f) - 1.0), 2)
        rows.append(
            (
                str(j + 1),
                mode.label,
                mode.kind,
                fixed(float(f), decimals),
                fixed(predicted, decimals + 1),
                fixed(float(result.predicted_sd[j]), decimals + 1),
                residual if residual.startswith("-") else f"+{residual}",
            )
        )
    for j in result.pairing.missed:
        mode = result.modes[j]
        rows.append(
            (
                str(j + 1),
                mode.label,
                mode.kind,
                "missed",
                fixed(float(result.predicted[j]), decimals + 1),
                "",
                "",
            )
        )
    return Table("Frequencies, posterior means, residual = predicted / measured - 1", columns, tuple(rows))


def _laminate(result: SampledIdentification) -> Table:
    rows = []
    for name, (mean, sd) in result.laminate.items():
        key, factor = laminate_unit(name)
        small = 1e-9 * abs(result.laminate["D11"][0])
        if name.startswith("D") and abs(mean) < small:
            continue
        value, spread = with_spread(mean * factor, sd * factor)
        unit = "N m" if name.startswith("D") else "GPa" if key.endswith("_GPa") else ""
        rows.append((name, f"{value} +- {spread} {unit}".strip()))
    return facts("Laminate in bending, mean and sd", tuple(rows))


def _chains(result: SampledIdentification, seed: int) -> Table:
    d = result.result.diagnostics
    ensembles, _, walkers, _ = result.result.chain.shape
    noise = [c for c in result.constants if c.name == NOISE]
    rows = []
    if noise:
        rows.append(
            ("noise", f"{100 * noise[0].mean:.2g} +- {100 * noise[0].sd:.2g} % of a frequency, inferred")
        )
    rows += [
        ("p-value", f"{result.p_value:.2f}, posterior predictive, of the sum of squared residuals"),
        ("chains", f"{ensembles} ensembles of {walkers} walkers, {d.steps} steps, burn-in {d.burn_in}"),
        (
            "convergence",
            f"R-hat {d.r_hat:.4f} over ensembles, autocorrelation time {d.autocorrelation_time:.0f} steps, "
            f"{d.ess_bulk:.0f} effective samples: {'converged' if d.converged else 'NOT converged'}",
        ),
        (
            "solver",
            f"error about {significant(100 * float(np.max(result.error)), 2)} % in the worst mode, "
            "part of the noise",
        ),
        ("work", f"{result.forward_solves} forward solves in {result.seconds:.1f} s, seed {seed}"),
    ]
    return facts("Sampling", tuple(rows))
