"""Screen of `identify --backend emcee`: a posterior, what determines it, and how far to trust it."""

from __future__ import annotations

import numpy as np

from cpam_bayes.formatting import decimals_of, fixed, signed, significant, with_spread
from cpam_bayes.forward_model.model import SIZES
from cpam_bayes.identification.sampled import ConstantPosterior, SampledResult
from cpam_bayes.inference.noise import NOISE_NAMES
from cpam_bayes.plate import to_user, unit_of
from cpam_bayes.priors import Prior, TruncatedNormal
from cpam_bayes.report.documents import laminate_unit
from cpam_bayes.report.modal_assurance.rows import assurance_sections
from cpam_bayes.report.plates.head import plate_section
from cpam_bayes.report.posterior.assessment import combinations_table, sensitivity_table
from cpam_bayes.report.sections import COMPUTATION, Section
from cpam_bayes.report.tables import Column, Table, facts, headed, remarks

# A mode this many standard deviations from what the others predict is marked.
_MAX_DISTANCE_SD = 3.0


def sections(result: SampledResult) -> tuple[Section, ...]:
    """Plate, marginal posteriors and what determines them, frequencies, chains."""
    return (
        plate_section(result.specimen, result.air_shifts),
        Section(
            "Posterior of the constants",
            (
                _marginals("Constants, posterior", result, result.elastic_constants),
                _marginals("Sizes, posterior", result, result.sizes),
                remarks("What the frequencies determine", _verdicts(result)),
                _laminate(result),
            ),
            ("marginals_and_profiles",),
            folded=False,
        ),
        Section(
            "Which constants move together, and what decides them",
            (combinations_table(result), sensitivity_table(result)),
            ("posterior",),
        ),
        Section("Measured and predicted frequencies", (_frequencies(result),), ("left_out",)),
        *assurance_sections(result.by_shape, result.posterior.measurement),
        Section("Mode shapes", figures=("modes",)),
        Section(COMPUTATION, (_chains(result),)),
    )


def _marginals(title: str, result: SampledResult, shown: tuple[ConstantPosterior, ...]) -> Table:
    columns = headed(
        "name", "#mean", "#sd", "#2.5 %", "#97.5 %", "unit", "#reference", "prior", "#contraction", "verdict"
    )
    rows = []
    for c in shown:
        mean, sd = with_spread(to_user(c.name, c.mean), to_user(c.name, c.sd))
        low, high = (with_spread(to_user(c.name, q), to_user(c.name, c.sd))[0] for q in (c.q025, c.q975))
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
                _prior(c.name, result.posterior.parameters[c.name].prior),
                fixed(c.contraction, 2),
                c.verdict,
            )
        )
    by_data = "determined by the data"
    doubtful = frozenset(i for i, c in enumerate(shown) if c.verdict != by_data and c.name not in SIZES)
    return Table(title, columns, tuple(rows), doubtful)


def _prior(name: str, prior: Prior) -> str:
    """A prior in the unit of the plate file."""
    bounds = f"{to_user(name, prior.lower):.6g} to {to_user(name, prior.upper):.6g}"
    if not isinstance(prior, TruncatedNormal):
        return bounds
    return f"{to_user(name, prior.loc):.6g} +- {to_user(name, prior.scale):.4g} in {bounds}"


def _verdicts(result: SampledResult) -> tuple[str, ...]:
    sentences = []
    constants = result.elastic_constants
    by_prior = [c.name for c in constants if c.verdict == "determined by the prior"]
    if by_prior:
        sentences.append(
            f"Determined by the prior, not by the frequencies: {', '.join(by_prior)}. Do not use "
            f"{'these values' if len(by_prior) > 1 else 'this value'}."
        )
    for c in constants:
        if c.bound is not None:
            fraction = max(c.at_lower, c.at_upper)
            sentences.append(
                f"{c.name}: {100 * fraction:.0f} % of the draws lie at its {c.bound} bound; the bound has a "
                "say in it, and the other constants depend on it."
            )
    sure = [c.name for c in constants if c.verdict == "determined by the data"]
    return (*sentences, f"Determined by the frequencies: {', '.join(sure) or 'none of the constants'}.")


def _frequencies(result: SampledResult) -> Table:
    columns = headed(
        "#mode",
        "label",
        "kind",
        "#measured Hz",
        "#predicted Hz",
        "#sd",
        "#residual %",
        "#leverage",
        "#left out %",
        "#sd %",
    )
    measured = result.posterior.measurement.frequencies
    decimals = decimals_of(measured)
    rows, doubtful = [], []
    for i, (f, row) in enumerate(zip(measured, result.frequencies, strict=True)):
        shown = fixed(float(f), decimals)
        if row is None:
            rows.append(("-", "", "no mode", shown, *6 * ("",)))
            continue
        left_out = row.left_out
        if abs(left_out.standardised) > _MAX_DISTANCE_SD:
            doubtful.append(i)
        rows.append(
            (
                str(row.number),
                row.mode.label,
                row.mode.kind,
                shown,
                fixed(row.predicted, decimals + 1),
                fixed(row.predicted_sd, decimals + 1),
                signed(100 * row.residual, 2),
                fixed(left_out.leverage, 2),
                signed(100 * left_out.residual, 2),
                fixed(100 * left_out.sd, 2),
            )
        )
    rows += [
        (
            str(m.number),
            m.mode.label,
            m.mode.kind,
            "missed",
            fixed(m.predicted, decimals + 1),
            *5 * ("",),
        )
        for m in result.missed
    ]
    title = "Frequencies, residual = predicted / measured - 1; left out: predicted from the other modes"
    return Table(title, columns, tuple(rows), frozenset(doubtful))


def _laminate(result: SampledResult) -> Table:
    """D11 to D26, the engineering constants and nuxy, a line each."""
    small = 1e-9 * abs(result.laminate["D11"][0])
    lines: dict[str, list[str]] = {"N m": [], "GPa": [], "": []}
    for name, (mean, sd) in result.laminate.items():
        key, factor = laminate_unit(name)
        if name.startswith("D") and abs(mean) < small:
            continue
        value, spread = with_spread(mean * factor, sd * factor)
        unit = "N m" if name.startswith("D") else "GPa" if key.endswith("_GPa") else ""
        lines[unit].append(f"{name} {value} +- {spread}")
    rows = tuple((f"{', '.join(parts)} {unit}".strip(),) for unit, parts in lines.items() if parts)
    return Table("Laminate in bending, mean and sd", (Column(),), rows)


def _chains(result: SampledResult) -> Table:
    d = result.result.diagnostics
    ensembles, _, walkers, _ = result.result.chain.shape
    noise = [c for c in result.constants if c.name in NOISE_NAMES]
    rows = []
    shape = "" if np.isinf(nu := result.posterior.degrees_of_freedom) else f", Student-t with {nu:g}"
    if noise:
        factor, unit = (1.0, "Hz") if noise[0].name == "absolute_sd" else (100.0, "% of a frequency")
        level, spread = factor * noise[0].mean, factor * noise[0].sd
        rows.append(("noise of the chains", f"{level:.2g} +- {spread:.2g} {unit}, inferred{shape}"))
    elif shape:
        rows.append(("noise of the chains", f"of the plate file{shape}"))
    rows += [
        ("p-value", _p_value(result)),
        *_left_out(result),
        ("evidence", _evidence(result)),
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
        (
            "work",
            f"{result.forward_solves} forward solves in {result.seconds:.1f} s, seed {result.seed}; "
            f"{result.ess_per_second:.0f} effective samples a second of sampling, "
            f"{d.ess_bulk / result.seconds:.0f} in all",
        ),
    ]
    return facts("Fit and sampling", tuple(rows))


def _p_value(result: SampledResult) -> str:
    """The p-value of the chains, and what it is the chance of."""
    said = f"{result.p_value:.2f}, the chance of residuals as large with the noise of the chains"
    if not result.posterior.noise_is_inferred:
        return f"{said}; small speaks against the plate model"
    return f"{said}, which is inferred from the same residuals: it checks the chains, not the plate model"


def _left_out(result: SampledResult) -> list[tuple[str, str]]:
    """The log score of modes left out, by importance sampling where that can be relied on."""
    left_out, psis = result.assessment.left_out, result.assessment.importance
    closed = f"log score {left_out.log_score:.1f} in closed form"
    if left_out.basis == "optimum":
        closed += ", linearised at the optimum (the posterior is far from a Gaussian)"
    if psis is None:
        return [("left out", closed)]
    if psis.reliable:
        score = f"log score {psis.log_score:.1f} +- {psis.standard_error:.1f} by importance sampling"
    else:
        worst = int(np.argmax(psis.k_hat))
        score = f"not reliable: k-hat {psis.k_hat[worst]:.2f} at frequency {worst + 1}, above 0.7"
    return [("left out", closed), ("PSIS-LOO", score)]


def _evidence(result: SampledResult) -> str:
    e = result.evidence
    value = f"log evidence {e.log_evidence:.3f} +- {e.standard_error:.3f}"
    sizes = f"{e.effective_size:.0f} effective of {e.n_draws} draws, k-hat {e.k_hat:.2f}"
    return f"{value}, importance sampling ({sizes}){'' if e.status == 'reliable' else ': NOT reliable'}"
