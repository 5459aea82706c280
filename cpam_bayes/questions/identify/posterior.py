"""The report of `identify --backend emcee`: the posterior, what determines it, and its reliability."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from cpam_bayes.formatting import NOT_KNOWN, fixed, listed, signed, significant, with_spread
from cpam_bayes.identification.point import BY_DATA, BY_PRIOR
from cpam_bayes.inference.assessment import MOVED, Combination, MovedBound
from cpam_bayes.inference.completeness import Profile
from cpam_bayes.plate import to_user
from cpam_bayes.questions.identify.emcee import SampledResult
from cpam_bayes.questions.identify.posterior_document import LeftOut, ListedMode, sampled_document
from cpam_bayes.render.figures import new_figure
from cpam_bayes.render.plate import (
    assurance_drawings,
    assurance_sections,
    measured_modes,
    plate_section,
)
from cpam_bayes.render.posterior import Draws, marginals_figure, pairs_figure
from cpam_bayes.render.report import (
    COMPUTATION,
    Caption,
    Column,
    Drawing,
    Heading,
    Report,
    Rows,
    Section,
    Table,
    facts,
    laminate_unit,
    remarks,
)
from cpam_bayes.render.sentences import (
    attached_step,
    bounds_step,
    constant_details,
    constant_rows,
    constants_headline,
    constants_table,
    correction_step,
    diagnose_step,
    errors_table,
    fit_sentence,
    frequency_columns,
    further_steps,
    gauge_step,
    intervals_sentence,
    mismatch_step,
    more_modes_step,
    references_said,
    reliance_table,
)
from cpam_bayes.render.spectrum import peak_drawings, peak_keys, peak_rows, peak_sections
from cpam_bayes.result import present

if TYPE_CHECKING:
    from matplotlib.figure import Figure


# A mode farther than this from the prediction of the others, in standard deviations, is marked.
_MAX_DISTANCE_SD: Final = 3.0
# Smaller exponents are left out of a product.
_SMALL: Final = 0.05
# Diagnoses of power scaling that mark a row as doubtful.
_DOUBTFUL: Final = ("prior and data disagree", "prior is strong, likelihood weak", "likelihood is weak")
# Smallest shift of a mean, in sd, that is reported for a moved bound.
_TOLD: Final = 0.1
# A bending-twisting stiffness below this fraction of D11 is rounding error.
_ROUNDING: Final = 1e-9

_BLUE, _GREY, _ORANGE = "#4878a8", "#808080", "#c1440e"


@present.register
def _present(result: SampledResult) -> Report:
    specimen, assessment = result.specimen, result.assessment
    constants, sizes = tuple(result.constants.values()), tuple(result.sizes.values())
    use = [c.name for c in constants if not c.is_open]
    steps = _steps(result, use)
    modes, peaks = _modes(result), peak_rows(specimen.measurement, result.frequencies)
    residuals = np.array([row.residual for row in result.frequencies if row.residual is not None])
    rms = float(np.sqrt(np.mean(residuals**2))) if residuals.size else math.nan
    headline = (
        "The chains did not converge: do not use this answer."
        if result.status == "budget"
        else constants_headline(constants, residuals.size)
    )
    return Report(
        summary=result.screen(
            headline=headline,
            tables=(constants_table(constants),),
            lines=(
                fit_sentence(
                    rms,
                    stated=None if result.noise else result.posterior.measurement.relative_noise,
                    measurement=specimen.measurement,
                    inferred=_inferred(result),
                    explained=result.explained,
                )
                if residuals.size
                else "None of the frequencies belongs to a mode of the plate model.",
                *_gaps(result),
                intervals_sentence(specimen.plate, result.scale_errors, use, also=references_said(specimen)),
            ),
            next_step=next(iter(steps), ""),
        ),
        sections=(
            plate_section(specimen, result.air_shifts),
            Section(
                "Posterior of the constants",
                (
                    constant_details((*constants, *sizes), specimen.material),
                    remarks("At the bounds", _at_bounds(result)),
                    errors_table(result.scale_errors, [c.name for c in constants]),
                    reliance_table(result.reliances, lambda n: result.posterior.parameters[n].prior, use),
                    _laminate(result.laminate),
                ),
                ("marginals_and_profiles",),
                folded=False,
            ),
            Section(
                "Which constants move together, and what determines them",
                (
                    _combinations_table(
                        result.posterior.model.parameters.names,
                        assessment.combinations[: len(result.constants)],
                    ),
                    _sensitivity_table(result),
                ),
                ("posterior",),
            ),
            Section(
                "Measured and predicted frequencies",
                (
                    modes.table(
                        "Frequencies, residual = predicted / measured - 1; left out: from the other modes"
                    ),
                ),
                ("left_out",),
            ),
            *peak_sections(specimen, peaks),
            *assurance_sections(result.by_shape, result.posterior.measurement),
            Section("Mode shapes", figures=("modes",)),
            further_steps(steps[1:]),
            Section(COMPUTATION, (_chains(result),)),
        ),
        document=sampled_document(result, modes) | peak_keys(peaks),
        drawings=(*_drawings(result, modes), *peak_drawings(specimen, peaks)),
        rows=(constant_rows(constants), modes, *((peaks,) if peaks.rows else ())),
    )


def _inferred(result: SampledResult) -> float | None:
    """Inferred noise relative to a typical frequency; None where the plate file states the noise."""
    if result.noise is None:
        return None
    name, marginal = result.noise
    relative = name == "relative_std"
    return marginal.mean / (1.0 if relative else float(np.mean(result.posterior.measurement.frequencies)))


def _gaps(result: SampledResult) -> tuple[str, ...]:
    """Modes without a frequency and frequencies without a mode, as one line."""
    missed = [f"{m.label or m.kind} near {significant(m.predicted or 0.0, 4)} Hz" for m in result.missed]
    alone = [f"{row.measured:.6g} Hz" for row in result.frequencies if row.predicted is None]
    one, several = _MEASURED[result.pairing_probability is not None]
    said = [f"Modes without a {one}: {listed(missed, 'and')}."] if missed else []
    said += [f"{several.capitalize()} without a mode: {listed(alone, 'and')}."] if alone else []
    return (" ".join(said),) if said else ()


# Words for a measured frequency: of a list, or of candidate peaks.
_MEASURED: Final = (("frequency", "frequencies"), ("peak", "peaks"))


def _steps(result: SampledResult, use: Sequence[str]) -> tuple[str, ...]:
    specimen = result.specimen
    mismatch = mismatch_step(specimen, result.notices, [row.label for row in result.frequencies])
    first = (
        *((correction_step(result.texts()),) if result.explained_by else ()),
        *(_longer_chains(result) if result.status == "budget" else ()),
        *(() if result.explained_by else (*bounds_step(result.notices), *mismatch)),
        diagnose_step(specimen),
    )
    if result.status == "budget":
        return first
    return (
        *first,
        *attached_step(specimen),
        *gauge_step(specimen, result.scale_errors, use),
        *more_modes_step(tuple(result.constants.values())),
    )


def _longer_chains(result: SampledResult) -> tuple[str, ...]:
    """Next step for chains that did not converge: more time where the limit cut them, else more steps."""
    late = any(n.code == "time_up" and "cut_chains" in dict(n.facts["missing"]) for n in result.notices)
    return (f"allow more {'time: --time-limit S' if late else 'steps: --steps N'}.",)


def _at_bounds(result: SampledResult) -> tuple[str, ...]:
    """A sentence for each constant whose posterior touches a bound of its prior."""
    touching = ((name, c.bound, result.marginals[name]) for name, c in result.constants.items() if c.bound)
    return tuple(
        f"{name}: {100 * max(m.at_lower, m.at_upper):.0f} % of the draws lie at its {bound} bound; a wider "
        "range would change it, and the other constants with it."
        for name, bound, m in touching
    )


def _modes(result: SampledResult) -> Rows:
    """Rows of the measured frequencies and of the modes missing from the list."""
    rows, left = result.frequencies, result.assessment.left_out
    others = iter(
        LeftOut(-float(r / f), float(sd / f), float(leverage), float(standardised))
        for r, sd, leverage, standardised, f in zip(
            left.residual,
            left.sd,
            left.leverage,
            left.standardised,
            (row.measured for row in rows if row.predicted is not None),
            strict=True,
        )
    )
    shown = [ListedMode(row, None if row.predicted is None else next(others)) for row in rows]
    shown += [ListedMode(row, None) for row in result.missed]

    def percent(name: str) -> Any:
        return lambda m: None if m.left_out is None else 100.0 * getattr(m.left_out, name)

    base = [
        Column(c.heading, c.key, lambda m, c=c: c.value(m.row), c.text, c.number)  # type: ignore[misc]
        for c in frequency_columns(rows)
    ]
    columns = (
        *base,
        Column(
            "sd Hz",
            "predicted_sd_hz",
            lambda m: m.left_out and m.row.predicted_sd,
            lambda v: significant(v, 2),
            True,
        ),
        Column("leverage", None, lambda m: m.left_out and m.left_out.leverage, lambda v: fixed(v, 2), True),
        Column("left out %", None, percent("residual"), lambda v: signed(v, 2), True),
        Column("sd %", None, percent("sd"), lambda v: fixed(v, 2), True),
        Column("", None, partial(_place, result.pairing_probability is not None)),
    )
    return Rows("frequencies", columns, tuple(shown), _is_far)


def _is_far(m: ListedMode) -> bool:
    return m.left_out is not None and abs(m.left_out.standardised) > _MAX_DISTANCE_SD


def _place(of_peaks: bool, m: ListedMode) -> str | None:
    if m.row.measured is None:
        return f"no {_MEASURED[of_peaks][0]}"
    if m.row.predicted is None:
        return "no mode"
    return "the others contradict it" if _is_far(m) else None


def _laminate(laminate: Mapping[str, tuple[float, float]]) -> Table:
    """Flexural stiffnesses D11 to D26, engineering constants and nuxy, mean +- sd, one line per unit."""
    small = _ROUNDING * abs(laminate["D11"][0])
    lines: dict[str, list[str]] = {"N m": [], "GPa": [], "": []}
    for name, (mean, sd) in laminate.items():
        factor = laminate_unit(name)[1]
        unit = "GPa" if factor != 1.0 else "" if name == "nuxy" else "N m"
        if unit == "N m" and abs(mean) < small:
            continue
        value, spread = with_spread(mean * factor, sd * factor)
        lines[unit].append(f"{name} {value} +- {spread}")
    rows = tuple((f"{', '.join(parts)} {unit}".strip(),) for unit, parts in lines.items() if parts)
    return Table("Laminate in bending, mean and sd", (Heading(),), rows)


_COMBINATIONS: Final = (
    Heading("combination"),
    *(Heading(text, number=True) for text in ("sd by data", "sd by prior", "prior / data")),
    Heading("determined by"),
)


def _combinations_table(names: tuple[str, ...], combinations: Sequence[Combination]) -> Table:
    """Combinations of constants, the best determined first, with their spread by data and by prior."""
    rows = tuple(
        (
            product_text(names, c),
            _percent(c.noise_sd),
            _percent(c.prior_sd),
            significant(c.singular_value, 2),
            _decider(c),
        )
        for c in combinations
    )
    doubtful = frozenset(i for i, c in enumerate(combinations) if c.contraction < BY_PRIOR)
    return Table("Combinations of constants, best determined first", _COMBINATIONS, rows, doubtful)


def product_text(names: tuple[str, ...], combination: Combination) -> str:
    """A product of powers, the largest first: ``E1 G12^0.32``; exponents below 0.05 are left out."""
    order = np.argsort(-np.abs(combination.exponents), kind="stable")
    parts = []
    for k in order:
        power = float(combination.exponents[k])
        if abs(power) >= _SMALL:
            parts.append(names[k] if round(power, 2) == 1.0 else f"{names[k]}^{power:.2g}")
    return " ".join(parts)


def _decider(combination: Combination) -> str:
    if combination.contraction >= BY_DATA:
        return "the data"
    return "the prior" if combination.contraction < BY_PRIOR else "data and prior"


def _percent(sd: float) -> str:
    """The standard deviation of a logarithm in percent."""
    return f"{significant(100.0 * sd, 2)} %" if sd < 1.0 else "> 100 %"


def _sensitivity_table(result: SampledResult) -> Table:
    """Profile likelihood of each constant, and the sensitivity to prior, noise prior and bounds."""
    assessment = result.assessment
    by_name = {s.name: s for s in assessment.power_scaling}
    columns = (
        Heading("name"),
        Heading("95 % by likelihood"),
        Heading("likelihood", number=True),
        Heading("prior", number=True),
        Heading("noise prior", number=True),
        Heading("diagnosis"),
        Heading(f"a bound moved {100 * MOVED:.0f} %"),
    )
    names = result.posterior.parameters.names
    rows, doubtful = [], []
    for i, profile in enumerate(assessment.profiles):
        s = by_name[profile.name]
        sensitivities = (fixed(value, 2) for value in (s.likelihood, s.prior, s.noise_prior))
        shift = _largest_shift(assessment.moved_bounds, names.index(profile.name))
        rows.append((profile.name, _interval(profile), *sensitivities, s.diagnosis, shift))
        if s.diagnosis in _DOUBTFUL:
            doubtful.append(i)
    title = "Profile likelihood, and sensitivity to powers of likelihood and priors (notable from 0.05)"
    return Table(title, columns, tuple(rows), frozenset(doubtful))


def _interval(profile: Profile) -> str:
    """The 95 % region of a profile likelihood, in plate-file units."""
    gaps = "" if profile.parts == 1 else f" in {profile.parts} parts"
    if profile.lower_open and profile.upper_open:
        return f"unbounded{gaps}"
    width = profile.upper - profile.lower
    digits = max(0, 1 - math.floor(math.log10(to_user(profile.name, width)))) if width > 0.0 else 3
    lower, upper = (fixed(to_user(profile.name, v), digits) for v in (profile.lower, profile.upper))
    if profile.lower_open:
        return f"up to {upper}{gaps}"
    return f"from {lower}{gaps}" if profile.upper_open else f"{lower} to {upper}{gaps}"


def _largest_shift(moved: tuple[MovedBound, ...], k: int) -> str:
    """The largest shift of the mean of parameter k by a moved bound, ``-`` where it is small."""
    known = [m for m in moved if np.isfinite(m.shift[k])]
    if not known:
        return NOT_KNOWN
    largest = max(known, key=lambda m: abs(m.shift[k]))
    if abs(largest.shift[k]) < _TOLD:
        return NOT_KNOWN
    return f"{largest.shift[k]:+.1f} sd, {largest.bound} of {largest.name}"


def _chains(result: SampledResult) -> Table:
    d = result.result.diagnostics
    ensembles, _, walkers, _ = result.result.chain.shape
    rows = []
    shape = "" if np.isinf(nu := result.posterior.degrees_of_freedom) else f", Student-t with {nu:g}"
    if result.noise is not None:
        name, noise = result.noise
        factor, unit = (1.0, "Hz") if name == "absolute_sd" else (100.0, "% of a frequency")
        level = f"{factor * noise.mean:.2g} +- {factor * noise.sd:.2g} {unit}"
        rows.append(("noise of the chains", f"{level}, inferred{shape}"))
    elif shape:
        rows.append(("noise of the chains", f"of the plate file{shape}"))
    rows += [
        ("p-value", _p_value(result)),
        *_scores(result),
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
    said = f"{result.p_value:.2f}, the chance of residuals this large at the noise of the chains"
    if not result.posterior.noise_is_inferred:
        return f"{said}; a small one contradicts the plate model"
    return f"{said}, which is inferred from the same residuals: it checks the chains, not the plate model"


def _scores(result: SampledResult) -> list[tuple[str, str]]:
    """Leave-one-out log scores: in closed form, and by importance sampling where that is reliable."""
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
    value = f"log evidence {e.log_evidence:.3f} +- {e.standard_error:.3f}, importance sampling"
    sizes = f"{e.effective_size:.0f} effective of {e.solves} draws, k-hat {e.k_hat:.2f}"
    exact = f"on the whole basis {100.0 * e.exact_fraction:.4g} % of those of the chains"
    return f"{value} ({sizes}; {exact}){'' if e.status == 'reliable' else ': NOT reliable'}"


def _drawings(result: SampledResult, modes: Rows) -> tuple[Drawing, ...]:
    """Marginals and profiles, then pairs, modes left out, mode shapes."""
    constants = listed([p.name for p in result.assessment.profiles], "and")
    rows = [m.row for m in modes.rows if m.left_out is not None]
    title, draws = result.specimen.name, _draws(result)
    names = listed(list(draws.names), "and")
    return (
        Drawing(
            "marginals_and_profiles",
            partial(marginals_figure, title, draws, result.assessment.profiles),
            Caption(
                "Above: a posterior (blue) much narrower than its prior (grey line) is determined by the "
                "frequencies; one as wide as the prior is not. Below: the fit that the frequencies alone "
                "leave at each value; a curve that stays above the dashed line over the whole interval "
                "excludes no value.",
                f"Marginal posteriors, priors and profile likelihoods of {constants}.",
            ),
        ),
        Drawing(
            "posterior",
            partial(pairs_figure, title, draws),
            Caption(
                "Diagonal: the posterior of each parameter. Below: pairs of parameters; a slanted cloud "
                "means that the frequencies determine a combination of both better than either.",
                f"Pairs of posterior draws of {names}.",
            ),
        ),
        Drawing(
            "left_out",
            partial(_left_out_figure, result, modes),
            Caption(
                "Blue: what the model with all frequencies predicts. Orange: what the other frequencies "
                "predict for this one. A bar that misses zero is a frequency that the others contradict. "
                "Leverage near one: no other frequency checks this one.",
                f"Residuals of {len(rows)} modes by all and by the other modes, and the leverage of each.",
            ),
        ),
        measured_modes(
            result.specimen,
            rows,
            [result.shapes[row.number - 1] for row in rows],
            [result.modes[row.number - 1] for row in rows],
        ),
        *assurance_drawings(result.specimen.name, result.by_shape, result.posterior.measurement),
    )


def _draws(result: SampledResult) -> Draws:
    """Draws to be plotted, without sizes whose sd the file does not state: these are as assumed."""
    stated = {name: c.reference for name, c in (*result.constants.items(), *result.sizes.items())}
    every = result.posterior.parameters.parameters
    of_plate = result.specimen.plate.sd
    drawn = [k for k, p in enumerate(every) if p.name not in result.sizes or p.name in of_plate]
    parameters = [every[k] for k in drawn]
    return Draws(
        names=tuple(p.name for p in parameters),
        values=result.result.draws[:, drawn],
        priors=tuple(p.prior for p in parameters),
        references=tuple(stated.get(p.name, math.nan) for p in parameters),
    )


def _left_out_figure(result: SampledResult, modes: Rows) -> Figure:
    """Each frequency against its posterior and its leave-one-out prediction; its leverage."""
    rows: list[ListedMode] = [m for m in modes.rows if m.left_out is not None]
    names = [f"{m.row.number}\n{m.row.label}" for m in rows]
    x = np.arange(len(rows))
    figure = new_figure(max(5.8, 0.8 * len(rows)), 4.8)
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(3, 1))
    upper.axhline(0.0, color="0.5", linewidth=1)
    style = {"fmt": "o", "markersize": 5, "capsize": 0, "elinewidth": 1.6}
    upper.errorbar(
        x - 0.12,
        [100 * (m.row.residual or 0.0) for m in rows],
        [200 * m.row.predicted_sd / (m.row.measured or 1.0) for m in rows],
        color=_BLUE,
        label="predicted by all modes, 2 sd",
        **style,
    )
    upper.errorbar(
        x + 0.12,
        [100 * m.left_out.residual for m in rows if m.left_out is not None],
        [200 * m.left_out.sd for m in rows if m.left_out is not None],
        color=_ORANGE,
        label="by the other modes, 2 sd with noise",
        **style,
    )
    upper.set_ylabel("predicted / measured - 1, %")
    figure.legend(loc="outside lower center", ncols=2, frameon=False, fontsize="small")
    lower.bar(x, [m.left_out.leverage for m in rows if m.left_out is not None], 0.5, color=_GREY)
    lower.set(ylim=(0, 1), ylabel="leverage", xlabel="mode")
    lower.set_xticks(x, names)
    upper.set_title(f"{result.specimen.name}: each mode predicted by all, and by the others", loc="left")
    return figure
