"""Figures of a sampled posterior: pairs, marginals beside profile likelihoods, modes left out."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import PowerNorm
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from numpy.typing import NDArray

from cpam_bayes.identification.sampled import ConstantPosterior, SampledResult
from cpam_bayes.inference.diagnostics.profiles import DROP_95, Profile
from cpam_bayes.inference.noise import NOISE_NAMES
from cpam_bayes.plate import to_user, unit_of, user_name
from cpam_bayes.report.modal_assurance.figure import assurance_figures
from cpam_bayes.report.mode_shapes import extent_of, shapes_figure

_BINS = 40
# Bins of a pair are wider, for its draws are spread over their square.
_PAIR_BINS = 26
# Colour grows as this power of the count: tails and lesser optima are seen.
_CONTRAST = 0.6
# Share of the draws beyond either end of the pairs.
_TAIL = 0.0005
_BLUE, _GREY, _RED, _ORANGE = "#4878a8", "#808080", "#c0392b", "#c1440e"
# Drops of log likelihood up to here are drawn.
_DEEPEST = 6.0


def figures(result: SampledResult) -> dict[str, Figure]:
    """Pairs of all parameters, marginals beside profiles of the constants, modes left out."""
    return {
        "posterior": _pairs(result),
        "marginals_and_profiles": _marginals_and_profiles(result),
        "left_out": _left_out(result),
        "modes": _modes(result),
        **assurance_figures(result.specimen.name, result.by_shape, result.posterior.measurement),
    }


def _pairs(result: SampledResult) -> Figure:
    names = result.posterior.parameters.names
    draws = result.result.draws * np.array([to_user(name, 1.0) for name in names])
    n = len(names)
    ends = np.quantile(draws, (_TAIL, 1.0 - _TAIL), axis=0)
    spans = [(float(low), float(high)) for low, high in ends.T]
    figure = Figure(figsize=(1.9 * n, 1.9 * n), layout="constrained")
    axes = figure.subplots(n, n, squeeze=False)
    for i in range(n):
        for j in range(n):
            here = axes[i, j]
            if j > i:
                here.set_axis_off()
                continue
            if i == j:
                _draw_marginal(here, result, result.constants[i], draws[:, i], spans[i])
            else:
                both = [spans[j], spans[i]]
                here.hist2d(
                    *(draws[:, j], draws[:, i], _PAIR_BINS),
                    range=both,
                    cmap="Blues",
                    norm=PowerNorm(_CONTRAST),
                    rasterized=True,
                )
                at = [result.constants[k].reference * to_user(names[k], 1.0) for k in (j, i)]
                here.plot(*at, "+", color=_RED, markersize=8)  # nothing where one is nan
                here.set(xlim=spans[j], ylim=spans[i])
            here.tick_params(labelsize=7)
            if i == n - 1:
                here.set_xlabel(_label(names[j]), fontsize=8)
            else:
                here.set_xticklabels([])
            if j == 0 and i > 0:
                here.set_ylabel(_label(names[i]), fontsize=8)
            elif j > 0:
                here.set_yticklabels([])
    figure.suptitle(f"{result.specimen.name}: posterior of the constants", fontsize=10)
    if n > 1:
        axes[0, n - 1].legend(handles=_key(), loc="upper right", frameon=False, fontsize=8)
    return figure


def _key() -> list[Any]:
    return [
        Patch(color=_BLUE, label="posterior"),
        Line2D([], [], color=_GREY, label="prior"),
        Line2D([], [], color=_RED, label="reference"),
    ]


def _draw_marginal(
    axes: Axes,
    result: SampledResult,
    c: ConstantPosterior,
    draws: NDArray[Any],
    span: tuple[float, float],
) -> None:
    factor = to_user(c.name, 1.0)
    axes.hist(draws, bins=_BINS, density=True, color=_BLUE, range=span)
    grid = np.linspace(*span, 400)
    prior = result.posterior.parameters[c.name].prior
    axes.plot(grid, np.exp(prior.log_density(grid / factor)) / factor, color=_GREY)
    if np.isfinite(c.reference):
        axes.axvline(c.reference * factor, color=_RED, linewidth=1.2)
    axes.set_xlim(*span)
    axes.set_yticks([])


def _marginals_and_profiles(result: SampledResult) -> Figure:
    """One column a constant: its marginal posterior and prior, and below its profile likelihood."""
    profiles = result.assessment.profiles
    names = result.posterior.parameters.names
    constants = {c.name: c for c in result.constants}
    figure = Figure(figsize=(max(5.0, 1.7 * len(profiles) + 0.4), 4.4), layout="constrained")
    axes = figure.subplots(2, len(profiles), squeeze=False, sharex="col")
    for upper, lower, profile in zip(axes[0], axes[1], profiles, strict=True):
        c, factor = constants[profile.name], to_user(profile.name, 1.0)
        draws = result.result.draws[:, names.index(profile.name)] * factor
        ends = profile.values[0] * factor, profile.values[-1] * factor
        _draw_marginal(upper, result, c, draws, ends)
        _draw_profile(lower, profile, factor)
        margin = 0.06 * (ends[1] - ends[0])
        lower.set_xlim(ends[0] - margin, ends[1] + margin)
        for here in (upper, lower):
            for bound in (c.lower * factor, c.upper * factor):
                here.axvline(bound, color="black", linewidth=1.4, linestyle=":")
            here.tick_params(labelsize=8)
        if np.isfinite(c.reference):
            lower.axvline(c.reference * factor, color=_RED, linewidth=1.2)
        lower.set_xlabel(_label(profile.name), fontsize=9)
    axes[0, 0].set_ylabel("density", fontsize=9)
    axes[1, 0].set_ylabel("profile log likelihood", fontsize=9)
    for here in axes[1, 1:]:
        here.set_yticklabels([])
    key = [
        *_key(),
        Line2D([], [], color="black", linestyle=":", label="bound"),
        Line2D([], [], color=_ORANGE, marker=".", label="profile"),
        Line2D([], [], color=_ORANGE, linestyle="--", label="95 % interval"),
    ]
    figure.legend(handles=key, loc="outside lower center", ncols=3, frameon=False, fontsize=8)
    figure.suptitle(f"{result.specimen.name}: marginal posteriors and profile likelihoods", fontsize=10)
    return figure


def _draw_profile(axes: Axes, profile: Profile, factor: float) -> None:
    values, drop = profile.values, np.minimum(profile.drop, 1e3)
    at = np.searchsorted(values, profile.best)
    values, drop = np.insert(values, at, profile.best), np.insert(drop, at, 0.0)
    axes.plot(values * factor, -drop, ".-", color=_ORANGE, markersize=5, linewidth=1.2)
    axes.axhline(-DROP_95, color=_ORANGE, linewidth=1, linestyle="--")
    axes.set_ylim(-_DEEPEST, 0.03 * _DEEPEST)


def _left_out(result: SampledResult) -> Figure:
    """Each frequency against the posterior and against what the other modes predict; its leverage."""
    rows = [row for row in result.frequencies if row is not None]
    names = [f"{row.number}\n{row.mode.label}" for row in rows]
    x = np.arange(len(rows))
    figure = Figure(figsize=(max(5.8, 0.8 * len(rows)), 4.8), layout="constrained")
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(3, 1))
    upper.axhline(0.0, color="0.5", linewidth=1)
    style = {"fmt": "o", "markersize": 5, "capsize": 0, "elinewidth": 1.6}
    upper.errorbar(
        x - 0.12,
        [100 * row.residual for row in rows],
        [200 * row.predicted_sd / row.measured for row in rows],
        color=_BLUE,
        label="predicted by all modes, 2 sd",
        **style,
    )
    upper.errorbar(
        x + 0.12,
        [100 * row.left_out.residual for row in rows],
        [200 * row.left_out.sd for row in rows],
        color=_ORANGE,
        label="by the other modes, 2 sd with noise",
        **style,
    )
    upper.set_ylabel("predicted / measured - 1, %")
    figure.legend(loc="outside lower center", ncols=2, frameon=False, fontsize="small")
    lower.bar(x, [row.left_out.leverage for row in rows], 0.5, color=_GREY)
    lower.set(ylim=(0, 1), ylabel="leverage", xlabel="mode")
    lower.set_xticks(x, names)
    upper.set_title(f"{result.specimen.name}: each mode predicted by all, and by the others")
    return figure


def _modes(result: SampledResult) -> Figure:
    """The shape of the mode that each measured frequency belongs to."""
    plate = result.specimen.plate
    rows = [row for row in result.frequencies if row is not None]
    return shapes_figure(
        f"{result.specimen.name}: modes of the measured frequencies",
        [f"{r.number}: {r.measured:g} Hz measured\n{r.mode.kind} {r.mode.label}" for r in rows],
        [result.shapes[row.number - 1] for row in rows],
        [row.mode.in_plane_fraction > 0.5 for row in rows],
        extent_of(plate.length, plate.width),
        plate.edges,
    )


def _label(parameter: str) -> str:
    if parameter in NOISE_NAMES:
        unit = unit_of(parameter)
        return f"noise, {unit.replace('hz', 'Hz')}" if unit else "relative noise"
    unit = unit_of(parameter)
    return f"{parameter}, {unit.replace('kg_m3', 'kg/m3')}" if unit else user_name(parameter)
