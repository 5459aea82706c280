"""Figures of a sampled posterior: pairs of parameters, and marginals with profile likelihoods."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.inference.completeness import DROP_95, Profile
from cpam_bayes.inference.posterior import NOISE_NAMES
from cpam_bayes.plate import to_user, unit_of, user_name
from cpam_bayes.priors import Prior
from cpam_bayes.render.figures import headed, new_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_BINS: Final = 40
# Coarser bins for pairs, whose draws spread over a square.
_PAIR_BINS: Final = 26
# Colour is this power of the count, so that tails and minor modes are visible.
_CONTRAST: Final = 0.6
# Share of the draws cut off at either end of the axes.
_TAIL: Final = 0.0005
_BLUE, _GREY, _RED, _ORANGE = "#4878a8", "#808080", "#c0392b", "#c1440e"
# Points of a drawn profile.
_FINE: Final = 1000
# Largest drawn drop of the log likelihood.
_DEEPEST: Final = 6.0


@dataclass(frozen=True, slots=True)
class Draws:
    """Posterior draws, SI.

    values : (n_draws, n)
    priors, references : of each parameter; a reference is nan where there is none
    """

    names: tuple[str, ...]
    values: NDArray[np.float64]
    priors: tuple[Prior, ...]
    references: tuple[float, ...]


def pairs_figure(title: str, sampled: Draws) -> Figure:
    """Draws of every pair of parameters, with the marginal posteriors on the diagonal."""
    from matplotlib.colors import PowerNorm

    names, priors, references = sampled.names, sampled.priors, sampled.references
    draws = sampled.values * np.array([to_user(name, 1.0) for name in names])
    n = len(names)
    ends = np.quantile(draws, (_TAIL, 1.0 - _TAIL), axis=0)
    spans = [(float(low), float(high)) for low, high in ends.T]
    figure = new_figure(1.9 * n, 1.9 * n)
    axes = figure.subplots(n, n, squeeze=False)
    for i in range(n):
        for j in range(n):
            here = axes[i, j]
            if j > i:
                here.set_axis_off()
                continue
            if i == j:
                _draw_marginal(here, names[i], priors[i], references[i], draws[:, i], spans[i])
            else:
                both = [spans[j], spans[i]]
                here.hist2d(
                    *(draws[:, j], draws[:, i], _PAIR_BINS),
                    range=both,
                    cmap="Blues",
                    norm=PowerNorm(_CONTRAST),
                    rasterized=True,
                )
                at = [references[k] * to_user(names[k], 1.0) for k in (j, i)]
                here.plot(*at, "+", color=_RED, markersize=8)  # nothing where one is nan
                here.set(xlim=spans[j], ylim=spans[i])
            here.tick_params(labelsize=8)
            if i == n - 1:
                here.set_xlabel(_label(names[j]), fontsize=8)
            else:
                here.set_xticklabels([])
            if j == 0 and i > 0:
                here.set_ylabel(_label(names[i]), fontsize=8)
            elif j > 0:
                here.set_yticklabels([])
    headed(figure, f"{title}: posterior of the constants")
    if n > 1:
        axes[0, n - 1].legend(handles=_key(), loc="upper right", frameon=False, fontsize=8)
    return figure


def _key() -> list[Any]:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    return [
        Patch(color=_BLUE, label="posterior"),
        Line2D([], [], color=_GREY, label="prior"),
        Line2D([], [], color=_RED, label="reference"),
    ]


def _draw_marginal(
    axes: Axes,
    name: str,
    prior: Prior,
    reference: float,
    draws: NDArray[Any],
    span: tuple[float, float],
) -> None:
    factor = to_user(name, 1.0)
    axes.hist(draws, bins=_BINS, density=True, color=_BLUE, range=span)
    grid = np.linspace(*span, 400)
    axes.plot(grid, np.exp(prior.log_density(grid / factor)) / factor, color=_GREY)
    if np.isfinite(reference):
        axes.axvline(reference * factor, color=_RED, linewidth=1.2)
    axes.set_xlim(*span)
    axes.set_yticks([])


def marginals_figure(title: str, sampled: Draws, profiles: Sequence[Profile]) -> Figure:
    """One column per constant: marginal posterior and prior above, profile likelihood below."""
    from matplotlib.lines import Line2D

    names, priors, references = sampled.names, sampled.priors, sampled.references
    figure = new_figure(max(5.0, 1.7 * len(profiles) + 0.4), 4.4)
    axes = figure.subplots(2, len(profiles), squeeze=False, sharex="col")
    for upper, lower, profile in zip(axes[0], axes[1], profiles, strict=True):
        i, factor = names.index(profile.name), to_user(profile.name, 1.0)
        prior, reference = priors[i], references[i]
        draws = sampled.values[:, i] * factor
        span = _span_of(draws, profile, factor, reference * factor)
        _draw_marginal(upper, profile.name, prior, reference, draws, span)
        _draw_profile(lower, profile, factor)
        lower.set_xlim(*span)
        for here in (upper, lower):
            for bound in (prior.lower * factor, prior.upper * factor):
                here.axvline(bound, color="black", linewidth=1.4, linestyle=":")
            here.tick_params(labelsize=8)
        if np.isfinite(reference):
            lower.axvline(reference * factor, color=_RED, linewidth=1.2)
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
    headed(figure, f"{title}: marginal posteriors and profile likelihoods")
    return figure


def _span_of(draws: NDArray[Any], profile: Profile, factor: float, reference: float) -> tuple[float, float]:
    """Limits of an axis: draws, upper part of the profile and reference, with a margin."""
    shown = [*np.quantile(draws, (_TAIL, 1.0 - _TAIL)), *(factor * profile.values[profile.drop < DROP_95])]
    if np.isfinite(reference):
        shown.append(reference)
    room = 0.4 * (max(shown) - min(shown))
    ends = factor * profile.values[0], factor * profile.values[-1]
    margin = 0.03 * (ends[1] - ends[0])
    return max(min(shown) - room, ends[0] - margin), min(max(shown) + room, ends[1] + margin)


def _draw_profile(axes: Axes, profile: Profile, factor: float) -> None:
    """A profile through its points, interpolated in its signed root, which is straight for a parabola."""
    values, drop = profile.values, np.minimum(profile.drop, 1e3)
    at = np.searchsorted(values, profile.best)
    values, drop = np.insert(values, at, profile.best), np.insert(drop, at, 0.0)
    fine = np.linspace(values[0], values[-1], _FINE)
    between = np.interp(fine, values, np.sign(values - profile.best) * np.sqrt(np.maximum(drop, 0.0)))
    axes.plot(fine * factor, -(between**2), color=_ORANGE, linewidth=1.2)
    axes.plot(values * factor, -drop, ".", color=_ORANGE, markersize=5)
    axes.axhline(-DROP_95, color=_ORANGE, linewidth=1, linestyle="--")
    axes.set_ylim(-_DEEPEST, 0.03 * _DEEPEST)


def _label(parameter: str) -> str:
    if parameter in NOISE_NAMES:
        unit = unit_of(parameter)
        return f"noise, {unit.replace('hz', 'Hz')}" if unit else "relative noise"
    unit = unit_of(parameter)
    return f"{parameter}, {unit.replace('kg_m3', 'kg/m3')}" if unit else user_name(parameter)
