"""Pictures of `sequence`: every angle ply by ply, the credible set, the constants."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from cpam_bayes.inference.posterior import NOISE
from cpam_bayes.plate import to_user, unit_of
from cpam_bayes.stacking.mixture import StackingMixture
from cpam_bayes.stacking.queries.angle_information import angle_information
from cpam_bayes.stacking.queries.given_layup import GivenLayup
from cpam_bayes.stacking.records import CREDIBLE, StackingPosterior
from cpam_bayes.stacking.sequence import StackingResult

_RED, _BLUE = "#c0392b", "#4878a8"
# Classes whose angles are shown: so many, and those that matter.
_SHOWN, _FEWEST, _MATTERS = 24, 4, 0.999
# Points of a density, and the share of the draws beyond either end of it.
_POINTS, _TAIL = 300, 0.001


def figures(result: StackingResult) -> dict[str, Figure]:
    """The heat map of the angles, the credible set, the constants."""
    answer = result.answer
    return {
        "angles": angle_map(answer, result.given),
        "credible_set": credible_set(answer, result.given),
        "constants": constants_over_sequences(answer, result.mixture, result.given),
    }


def angle_map(result: StackingPosterior, given: GivenLayup | None = None) -> Figure:
    """Probability of each angle for each unknown, from the bottom; entropies at the right."""
    k = len(result.marginals)
    information = angle_information(result.specimen.plate.layup, result.marginals)
    figure = Figure(figsize=(6.4, 1.9 + 0.45 * k), layout="constrained")
    axes = figure.subplots()
    step = result.grid_deg[1] - result.grid_deg[0] if len(result.grid_deg) > 1 else 180.0
    edges = np.append(result.grid_deg - step / 2, result.grid_deg[-1] + step / 2)
    drawn = axes.pcolormesh(edges, np.arange(k + 1) + 0.5, result.marginals, cmap="Greys", vmin=0.0)
    plies = np.arange(k) + 1
    axes.plot(result.top[0], plies, "o", ms=9, mfc="none", mec=_RED, mew=1.5, label="most probable sequence")
    if given is not None:
        axes.plot(given.angles_deg, plies, "x", ms=6, color=_BLUE, mew=2, label="printed sequence")
    axes.set(xlabel="angle, degrees", ylabel="unknown angle", xticks=np.arange(-90, 91, 30))
    axes.set_title(f"{result.specimen.name}: {_counted(result.credible_count)} in the 95 % set", fontsize=11)
    labels = [
        f"{j}: {bits:.1f} of {information.most_bits:.1f} bits open"
        for j, bits in zip(plies, information.entropy_bits, strict=True)
    ]
    axes.set_yticks(plies, labels)
    axes.invert_yaxis()
    figure.legend(loc="outside lower left", ncols=2, frameon=False)
    figure.colorbar(drawn, ax=axes, label="probability")
    return figure


def _counted(n: int) -> str:
    return f"{n} sequence" + ("s" if n != 1 else "")


def credible_set(result: StackingPosterior, given: GivenLayup | None = None) -> Figure:
    """Angles and probabilities of the most probable sequences, and what sets of them hold."""
    mass, k = result.probability * result.multiplicity, result.top.shape[1]
    n = int(np.clip(np.searchsorted(np.cumsum(mass), _MATTERS) + 1, _FEWEST, _SHOWN))
    n = min(n, len(mass))
    figure = Figure(figsize=(8.0, max(3.4, 1.3 + 0.24 * n)), layout="constrained")
    table, bars, curve = figure.subplots(1, 3, width_ratios=(0.9 + 0.45 * k, 2.2, 3.2))
    _draw_angles(table, result.top[:n])
    rows = np.arange(n) + 1
    bars.barh(rows, mass[:n], 0.7, color=_BLUE)
    if given is not None and given.index is not None and given.index < n:
        bars.barh(given.index + 1, mass[given.index], 0.7, color=_RED)
        bars.text(mass[given.index], given.index + 1, " printed", va="center", fontsize=8, color=_RED)
    bars.set(ylim=(n + 0.5, 0.5), yticks=[], xlabel="probability with its images", xlim=(0.0, 1.2 * mass[0]))
    bars.locator_params(axis="x", nbins=3)  # long numbers, little room
    bars.spines[["top", "right"]].set_visible(False)
    number, held = np.cumsum(result.multiplicity), np.cumsum(mass)
    curve.step(np.append(0.9, number), np.append(0.0, held), where="post", color=_BLUE)
    if result.credible_count > number[-1]:
        between = [number[-1], result.credible_count], [held[-1], CREDIBLE]
        curve.plot(*between, ":", color=_BLUE, label="not listed, known as a sum")
    curve.plot(result.credible_count, CREDIBLE, "o", color=_RED, label="95 % set")
    curve.axhline(CREDIBLE, color="0.6", lw=0.8)
    curve.axvline(result.effective_count, color="0.6", ls="--", lw=0.8)
    left = result.effective_count > 0.05 * max(number[-1], result.credible_count)
    curve.text(
        result.effective_count,
        0.03,
        " effective number " if not left else "effective number ",
        ha="right" if left else "left",
        fontsize=8,
    )
    curve.set(xscale="log", xlabel="number of sequences", ylabel="probability of the set", ylim=(0.0, 1.03))
    curve.spines[["top", "right"]].set_visible(False)
    curve.legend(loc="lower right", bbox_to_anchor=(1.0, 0.1), frameon=False, fontsize=8)
    figure.suptitle(
        f"{result.specimen.name}: 95 % set of {_counted(result.credible_count)} of {result.enumerated}",
        fontsize=11,
    )
    return figure


def _draw_angles(axes: Axes, angles: NDArray[Any]) -> None:
    """Angles (n, k) as numbers on a colour that is the same for -90 and 90 degrees."""
    n, k = angles.shape
    edges = np.arange(k + 1) + 0.5, np.arange(n + 1) + 0.5
    axes.pcolormesh(*edges, angles, cmap="twilight_shifted", vmin=-90, vmax=90, alpha=0.55)
    for i in range(n):
        for j in range(k):
            axes.text(j + 1, i + 1, f"{angles[i, j]:g}", ha="center", va="center", fontsize=8)
    axes.set(ylim=(n + 0.5, 0.5), xticks=np.arange(k) + 1, xlabel="unknown angle", ylabel="rank of the class")
    axes.set_title("angles, degrees (like colours: like angles)", fontsize=8)
    axes.set_yticks(np.arange(n) + 1 if n < 10 else [1, *range(5, n + 1, 5)])
    axes.tick_params(length=0)
    axes.spines[:].set_visible(False)


def constants_over_sequences(
    result: StackingPosterior, mixture: StackingMixture, given: GivenLayup | None = None
) -> Figure:
    """Each constant's density over all sequences beside those given single sequences."""
    parameters = result.conditional.parameters
    chosen = [i for i, name in enumerate(parameters.names) if name != NOISE]
    columns = min(len(chosen), 4)
    rows = -(-len(chosen) // columns)
    figure = Figure(figsize=(max(6.0, 2.6 * columns), 0.8 + 2.1 * rows), layout="constrained")
    panels = np.atleast_1d(figure.subplots(rows, columns)).ravel()
    for empty in panels[len(chosen) :]:
        empty.set_axis_off()
    for panel, i in zip(panels, chosen, strict=False):
        p = parameters.parameters[i]
        unit = to_user(p.name, 1.0)
        curves: list[tuple[NDArray[Any], str | None, str]] = [
            (mixture.parameters[:, i], None, "all sequences")
        ]
        if mixture.components:
            curves.append((mixture.components[0].draws[:, i], _RED, "most probable sequence"))
        same = given is not None and given.index == 0
        if mixture.given is not None and not same:
            curves.append((mixture.given.draws[:, i], _BLUE, "printed sequence"))
        for draws, color, label in curves:
            x, y = _density(draws, p.prior.lower, p.prior.upper)
            if color is None:
                panel.fill_between(unit * x, y / unit, color="0.8", label=label)
            else:
                panel.plot(unit * x, y / unit, color=color, label=label)
        if p.name in result.specimen.material.constants:
            at = unit * result.specimen.material.constants[p.name]
            panel.axvline(at, color="k", ls=":", lw=1.0, label="reference")
        panel.set(xlabel=f"{p.name}, {unit_of(p.name)}".removesuffix(", "), yticks=[])
        panel.set_ylim(bottom=0.0)
        panel.spines[["top", "right", "left"]].set_visible(False)
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside upper center", ncols=4, frameon=False)
    return figure


def _density(draws: NDArray[Any], lower: float, upper: float) -> tuple[NDArray[Any], NDArray[Any]]:
    """A Gaussian kernel estimate over draws, mirrored at the bounds so that nothing leaks out of them."""
    low, high = np.quantile(draws, (_TAIL, 1.0 - _TAIL))
    # Silverman's rule, by the narrower of two measures of width
    width = min(draws.std(), (np.quantile(draws, 0.75) - np.quantile(draws, 0.25)) / 1.34)
    # draws that repeat others make it no finer
    width = max(0.9 * width * len(np.unique(draws)) ** -0.2, 2e-3 * (high - low), 1e-12 * abs(high))
    x = np.linspace(max(low - 3 * width, lower), min(high + 3 * width, upper), _POINTS)
    edges = np.linspace(min(low, draws.min()), max(high, draws.max()), 2001)
    count, _ = np.histogram(draws, edges)
    centre = 0.5 * (edges[1:] + edges[:-1])
    used = count > 0
    y = np.zeros_like(x)
    for at in (centre[used], 2 * lower - centre[used], 2 * upper - centre[used]):
        near = np.isfinite(at)
        y += np.exp(-0.5 * ((x[:, None] - at[near]) / width) ** 2) @ count[used][near]
    return x, y / (len(draws) * width * np.sqrt(2 * np.pi))
