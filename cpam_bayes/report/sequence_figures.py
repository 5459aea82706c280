"""Pictures of `sequence`: the probability of every angle, ply by ply, and the constants."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure

from cpam_bayes.inference.sequences import SequenceAnswer
from cpam_bayes.measurement import to_user
from cpam_bayes.posterior import NOISE
from cpam_bayes.report.plates import unit_of

if TYPE_CHECKING:
    from cpam_bayes.report.answer import Figures

__all__ = ["sequence_figures"]


def sequence_figures(result: SequenceAnswer) -> Figures:
    """The heat map of the angles, and the constants."""
    name = result.specimen.name
    return {f"angles_{name}": angle_map(result), f"constants_{name}": constants_over_sequences(result)}


def angle_map(result: SequenceAnswer) -> Figure:
    """Probability of each angle for each unknown, the outermost above, the most probable sequence marked."""
    k = len(result.marginals)
    figure = Figure(figsize=(8.0, 1.7 + 0.45 * k), layout="constrained")
    axes = figure.subplots()
    step = result.grid_deg[1] - result.grid_deg[0] if len(result.grid_deg) > 1 else 180.0
    edges = np.append(result.grid_deg - step / 2, result.grid_deg[-1] + step / 2)
    drawn = axes.pcolormesh(edges, np.arange(k + 1) + 0.5, result.marginals, cmap="Greys", vmin=0.0)
    axes.plot(result.top[0], np.arange(k) + 1, "o", mfc="none", mec="C3", label="most probable sequence")
    axes.set(
        xlabel="angle, degrees",
        ylabel="unknown angle",
        yticks=np.arange(k) + 1,
        xticks=np.arange(-90, 91, 30),
        title=f"{result.specimen.name}: {result.credible_count} sequences in the 95 % set",
    )
    axes.invert_yaxis()
    figure.legend(loc="outside lower left", frameon=False)
    figure.colorbar(drawn, ax=axes, label="probability")
    return figure


def constants_over_sequences(result: SequenceAnswer) -> Figure:
    """Each constant's density over all sequences beside that given the most probable sequence."""
    own = result.own.parameters
    chosen = [i for i, name in enumerate(own.names) if name != NOISE]
    figure = Figure(figsize=(2.6 * len(chosen), 2.6), layout="constrained")
    for panel, i in zip(np.atleast_1d(figure.subplots(1, len(chosen))), chosen, strict=True):
        p = own.parameters[i]
        unit = to_user(p.name, 1.0)
        x = np.linspace(p.prior.lower, p.prior.upper, 400)
        mixed = np.zeros_like(x)
        for w, mean, sd in zip(
            result.draw_weight,
            result.drawn.conditionals.mean[:, i],
            result.drawn.conditionals.sd[:, i],
            strict=True,
        ):
            mixed += w * _normal(x, mean, max(sd, 0.003 * (x[-1] - x[0])))
        panel.fill_between(unit * x, mixed / mixed.max(), color="0.8", label="all sequences")
        one = _normal(
            x,
            result.components.conditionals.mean[0, i],
            max(result.components.conditionals.sd[0, i], 0.003 * (x[-1] - x[0])),
        )
        panel.plot(unit * x, one / one.max(), color="C3", label="most probable sequence")
        if p.name in result.specimen.material.constants:
            panel.axvline(
                unit * result.specimen.material.constants[p.name], color="k", ls=":", label="reference"
            )
        panel.set(xlabel=f"{p.name} {unit_of(p.name)}".strip(), yticks=[])
    figure.legend(*panel.get_legend_handles_labels(), loc="outside upper center", ncols=3, frameon=False)
    return figure


def _normal(x: np.ndarray, mean: float, sd: float) -> np.ndarray:
    return np.asarray(np.exp(-0.5 * ((x - mean) / sd) ** 2) / sd)
