"""A posterior over stacking sequences: rows, tables and figures."""

from __future__ import annotations

import math
from collections.abc import Iterable
from functools import partial
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.formatting import fixed, probable, significant, with_spread
from cpam_bayes.plate import to_user, unit_of, user_name
from cpam_bayes.render.figures import headed, new_figure
from cpam_bayes.render.report import Caption, Column, Drawing, Rows, Table
from cpam_bayes.stacking.posterior import EMCEE, IMPORTANCE, StackingMixture
from cpam_bayes.stacking.queries import AngleInformation, GivenLayup, angle_information
from cpam_bayes.stacking.records import CREDIBLE, StackingPosterior

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Probability from which an angle is listed.
_LEAST_ANGLE: Final = 0.005


class ListedSequence(NamedTuple):
    """One listed class of equivalent stacking sequences, represented by its first member."""

    answer: StackingPosterior
    mixture: StackingMixture
    i: int

    @property
    def angles(self) -> str:
        """Angles of the first member, from the bottom."""
        return angles_text(self.answer.top[self.i])

    @property
    def together(self) -> float:
        """Probability of all sequences in the class."""
        return float(self.answer.probability[self.i] * self.answer.multiplicity[self.i])

    @property
    def is_sampled(self) -> bool:
        """True if sampled by emcee, False if by importance sampling."""
        return self.i < len(self.mixture.components)

    def moment(self, of: str) -> dict[str, float]:
        """The "mean" or "sd" of the constants by name, in plate-file units."""
        if self.is_sampled:
            return constants_by_name(self.answer, getattr(self.mixture.components[self.i].chains, of))
        return constants_by_name(self.answer, getattr(self.answer.components.conditionals, of)[self.i])


def angles_text(angles_deg: Iterable[float]) -> str:
    """Unknown angles as in a layup, 0/90/-45."""
    return "/".join(f"{a:g}" for a in angles_deg)


def constants_by_name(answer: StackingPosterior, values: NDArray[Any]) -> dict[str, float]:
    """Constants by name, in plate-file units; values : of all parameters, constants first."""
    n = answer.conditional.n_constants
    named = zip(answer.conditional.parameters.names[:n], values[:n], strict=True)
    return {user_name(name): to_user(name, float(v)) for name, v in named}


_RANK: Final = Column("rank", None, lambda s: s.i + 1, number=True)
_UNKNOWN: Final = Column("unknown angles, from the bottom", None, lambda s: s.angles)
_TOGETHER: Final = Column("probability", None, lambda s: s.together, probable, number=True)
FIRST_SCREEN: Final = (
    _RANK,
    _UNKNOWN,
    _TOGETHER,
    Column("equivalents", None, lambda s: int(s.answer.multiplicity[s.i]) - 1, number=True),
)
SEQUENCES: Final = (
    _RANK,
    _UNKNOWN,
    Column(None, "angles_deg", lambda s: s.answer.top[s.i].tolist()),
    Column(
        "probability each", "probability", lambda s: float(s.answer.probability[s.i]), probable, number=True
    ),
    Column("equivalent", "equivalent", lambda s: int(s.answer.multiplicity[s.i]), number=True),
    _TOGETHER,
    Column(None, "same_bending_deg", lambda s: s.answer.grid_deg[s.answer.same_bending[s.i]].tolist()),
    Column(
        "log evidence",
        "log_evidence",
        lambda s: float(s.answer.log_evidence[s.i]),
        lambda v: fixed(v, 2),
        number=True,
    ),
    Column(
        "+-",
        "log_evidence_error",
        lambda s: float(s.answer.log_evidence_error[s.i]),
        lambda v: fixed(v, 2),
        number=True,
    ),
    Column(None, "k_hat", lambda s: float(s.answer.components.conditionals.k_hat[s.i])),
    Column(None, "constants", lambda s: s.moment("mean")),
    Column(None, "constants_sd", lambda s: s.moment("sd")),
    Column(None, "sampled_by", lambda s: EMCEE if s.is_sampled else IMPORTANCE),
)


def angle_table(answer: StackingPosterior, information: AngleInformation) -> Table:
    """Table of the marginal posterior of each unknown angle."""

    def best(j: int) -> str:
        p = answer.marginals[j]
        order = np.argsort(-p, kind="stable")[:4]
        return ", ".join(f"{answer.grid_deg[a]:g} ({p[a]:.2f})" for a in order if p[a] >= _LEAST_ANGLE)

    def needed(j: int) -> str:
        p = np.sort(answer.marginals[j])[::-1]
        return f"{int(np.searchsorted(np.cumsum(p), 0.95)) + 1} of {len(p)}"

    columns = (
        Column("unknown", None, lambda j: j + 1, number=True),
        Column("most probable angles and their probability", None, best),
        Column("angles that hold 95 %", None, needed, number=True),
        Column("entropy, bits", None, lambda j: f"{abs(information.entropy_bits[j]):.2f}", number=True),
        Column(
            "fraction of D, %", None, lambda j: f"{100 * information.bending_fraction[j]:.1f}", number=True
        ),
    )
    return Rows("plies", columns, tuple(range(len(answer.marginals)))).table(
        "Angle by angle, from the bottom"
    )


def outer_and_inner(information: AngleInformation) -> str:
    """Sentence that compares the information about outer and inner plies."""
    bits = information.entropy_bits[information.outer_first]
    each = ", ".join(f"{abs(b):.2f}" for b in bits)
    if len(bits) < 2:
        return f"one unknown angle: {each} of {information.most_bits:.2f} bits are left open"
    better = "are" if information.outer_better else "are not always"
    return (
        f"outer angles {better} better determined than inner ones: entropy from the outermost in {each} of "
        f"{information.most_bits:.2f} bits; equally probable mirror images count 1 bit"
    )


class _Moments(NamedTuple):
    """Mean and sd of a constant as text: over all sequences, given the first, and given the printed one.

    off : largest difference between emcee and importance sampling, in standard errors.
    """

    name: str
    over_all: tuple[str, str]
    first: tuple[str, str] | None
    printed: tuple[str, str] | None
    reference: str
    off: str


def mixture_table(answer: StackingPosterior, mixture: StackingMixture, given: GivenLayup | None) -> Table:
    """Table of the constants over all sequences and given single ones."""
    first = mixture.components[0].chains if mixture.components else None
    printed = None if mixture.given is None or given is None else mixture.given.chains
    reference = answer.specimen.material.constants
    rows = []
    for i, name in enumerate(answer.specimen.unknowns.names):
        unit = to_user(name, 1.0)

        def written(moments: Any, i: int = i, unit: float = unit) -> tuple[str, str] | None:
            if moments is None:
                return None
            return with_spread(unit * float(moments.mean[i]), unit * float(moments.sd[i]))

        draws = mixture.parameters[:, i]
        rows.append(
            _Moments(
                user_name(name),
                with_spread(unit * float(draws.mean()), unit * float(draws.std())),
                written(first),
                written(printed),
                significant(unit * float(reference[name])) if name in reference else "",
                _off_importance(mixture, i),
            )
        )
    columns = (
        Column("name", None, lambda r: r.name),
        Column("mean", None, lambda r: r.over_all[0], number=True),
        Column("sd", None, lambda r: r.over_all[1], number=True),
        Column("given the first sequence", None, lambda r: r.first and r.first[0], number=True),
        Column("sd", None, lambda r: r.first and r.first[1], number=True),
        Column("given the printed one", None, lambda r: r.printed and r.printed[0], number=True),
        Column("sd", None, lambda r: r.printed and r.printed[1], number=True),
        Column("reference", None, lambda r: r.reference, number=True),
        Column("emcee vs importance sampling, standard errors", None, lambda r: r.off, number=True),
    )
    return Rows("constants", columns, tuple(rows)).table("Constants over all sequences")


def _off_importance(mixture: StackingMixture, i: int) -> str:
    """Largest difference between emcee and importance sampling in a parameter's mean or sd, in its error."""
    off = (
        abs(a - b) / math.hypot(a_error, b_error)
        for c in mixture.sampled
        for a, b, a_error, b_error in (
            (c.chains.mean[i], c.importance.mean[i], c.chains.mean_error[i], c.importance.mean_error[i]),
            (c.chains.sd[i], c.importance.sd[i], c.chains.sd_error[i], c.importance.sd_error[i]),
        )
    )
    worst = max(off, default=None)
    return "" if worst is None else f"{worst:.1f}"


def same_bending(answer: StackingPosterior) -> tuple[tuple[str, str], ...]:
    """Row on listed sequences that share their bending stiffness with sequences that are not their images."""
    several = [i for i, others in enumerate(answer.same_bending) if len(others)]
    if not several:
        return ()
    merged = sum(len(answer.alike[i]) > 0 for i in several)
    one, other = answer.top[several[0]], answer.grid_deg[answer.same_bending[several[0]][0]]
    said = f"{len(several)} of {len(answer.top)} listed share it with others, as {angles_text(one)} and"
    return (
        ("same bending", f"{said} {angles_text(other)}; {merged} merged with them, as nothing else differs"),
    )


def drawings(
    answer: StackingPosterior, mixture: StackingMixture, given: GivenLayup | None
) -> tuple[Drawing, ...]:
    """Drawings: probability of each angle, the credible set, the constants."""
    many = f"{answer.credible_count} of {answer.enumerated}"
    return (
        Drawing(
            "angles",
            partial(angle_map, answer, given),
            Caption(
                "One row for each unknown angle, the lowest ply first: a single dark cell is an angle that "
                "the frequencies determine, a grey row one that they leave open. The circle is the most "
                "probable sequence.",
                f"Probability of every angle for {len(answer.marginals)} unknown angles; most probable "
                f"{angles_text(answer.top[0])}.",
            ),
        ),
        Drawing(
            "credible_set",
            partial(credible_set, answer, given),
            Caption(
                "Left: the most probable sequences with their angles. Middle: the probability of each with "
                "its images, which no frequency tells apart. Right: how many sequences hold 95 % of the "
                "probability: one is an answer, many are a list to choose from by other knowledge.",
                f"The most probable stacking sequences; {many} hold 95 % of the probability.",
            ),
        ),
        Drawing(
            "constants",
            partial(constants_over_sequences, answer, mixture, given),
            Caption(
                "Grey: the constants whatever the sequence. A red curve elsewhere than the grey one says "
                "that the constants depend on which sequence is true.",
                "Posterior densities of the constants over all sequences and given the most probable one.",
            ),
        ),
    )


_RED, _BLUE = "#c0392b", "#4878a8"
# Most and fewest classes shown, and the total probability up to which they are.
_SHOWN, _FEWEST, _MATTERS = 24, 4, 0.999
# Points of a density, and the share of the draws cut off at either end.
_POINTS, _TAIL = 300, 0.001


def angle_map(answer: StackingPosterior, given: GivenLayup | None = None) -> Figure:
    """Probability of each angle for each unknown ply, from the bottom; entropies on the right."""
    k = len(answer.marginals)
    information = angle_information(answer.specimen.plate.layup, answer.marginals)
    figure = new_figure(6.4, 1.9 + 0.45 * k)
    axes = figure.subplots()
    step = answer.grid_deg[1] - answer.grid_deg[0] if len(answer.grid_deg) > 1 else 180.0
    edges = np.append(answer.grid_deg - step / 2, answer.grid_deg[-1] + step / 2)
    drawn = axes.pcolormesh(edges, np.arange(k + 1) + 0.5, answer.marginals, cmap="Greys", vmin=0.0)
    plies = np.arange(k) + 1
    axes.plot(answer.top[0], plies, "o", ms=9, mfc="none", mec=_RED, mew=1.5, label="most probable sequence")
    if given is not None:
        axes.plot(given.angles_deg, plies, "x", ms=6, color=_BLUE, mew=2, label="printed sequence")
    axes.set(xlabel="angle, degrees", ylabel="unknown angle", xticks=np.arange(-90, 91, 30))
    axes.set_title(
        f"{answer.specimen.name}: {_counted(answer.credible_count)} in the 95 % set", fontsize=11, loc="left"
    )
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


def credible_set(answer: StackingPosterior, given: GivenLayup | None = None) -> Figure:
    """Angles and probabilities of the most probable sequences, and their cumulative probability."""
    mass, k = answer.probability * answer.multiplicity, answer.top.shape[1]
    n = int(np.clip(np.searchsorted(np.cumsum(mass), _MATTERS) + 1, _FEWEST, _SHOWN))
    n = min(n, len(mass))
    figure = new_figure(8.0, max(3.4, 1.3 + 0.24 * n))
    table, bars, curve = figure.subplots(1, 3, width_ratios=(0.9 + 0.45 * k, 2.2, 3.2))
    _draw_angles(table, answer.top[:n])
    rows = np.arange(n) + 1
    bars.barh(rows, mass[:n], 0.7, color=_BLUE)
    if given is not None and given.index is not None and given.index < n:
        bars.barh(given.index + 1, mass[given.index], 0.7, color=_RED)
        bars.text(mass[given.index], given.index + 1, " printed", va="center", fontsize=8, color=_RED)
    bars.set(ylim=(n + 0.5, 0.5), yticks=[], xlabel="probability with its images", xlim=(0.0, 1.2 * mass[0]))
    bars.locator_params(axis="x", nbins=3)  # long numbers, little room
    bars.spines[["top", "right"]].set_visible(False)
    number, held = np.cumsum(answer.multiplicity), np.cumsum(mass)
    curve.step(np.append(0.9, number), np.append(0.0, held), where="post", color=_BLUE)
    if answer.credible_count > number[-1]:
        between = [number[-1], answer.credible_count], [held[-1], CREDIBLE]
        curve.plot(*between, ":", color=_BLUE, label="not listed, known as a sum")
    curve.plot(answer.credible_count, CREDIBLE, "o", color=_RED, label="95 % set")
    curve.axhline(CREDIBLE, color="0.6", lw=0.8)
    curve.axvline(answer.effective_count, color="0.6", ls="--", lw=0.8)
    left = answer.effective_count > 0.05 * max(number[-1], answer.credible_count)
    curve.text(
        answer.effective_count,
        0.03,
        " effective number " if not left else "effective number ",
        ha="right" if left else "left",
        fontsize=8,
    )
    curve.set(xscale="log", xlabel="number of sequences", ylabel="probability of the set", ylim=(0.0, 1.03))
    curve.spines[["top", "right"]].set_visible(False)
    curve.legend(loc="lower right", bbox_to_anchor=(1.0, 0.1), frameon=False, fontsize=8)
    headed(
        figure,
        f"{answer.specimen.name}: 95 % set of {_counted(answer.credible_count)} of {answer.enumerated}",
    )
    return figure


def _draw_angles(axes: Axes, angles: NDArray[Any]) -> None:
    """Angles (n, k) as numbers on a cyclic colour scale, equal for -90 and 90 degrees."""
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
    answer: StackingPosterior, mixture: StackingMixture, given: GivenLayup | None = None
) -> Figure:
    """Density of each constant over all sequences and given single ones."""
    parameters = answer.conditional.parameters
    chosen = range(answer.conditional.n_constants)
    columns = min(len(chosen), 4)
    rows = -(-len(chosen) // columns)
    figure = new_figure(max(6.0, 2.6 * columns), 0.8 + 2.1 * rows)
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
        if p.name in answer.specimen.material.constants:
            at = unit * answer.specimen.material.constants[p.name]
            panel.axvline(at, color="k", ls=":", lw=1.0, label="reference")
        panel.set(xlabel=f"{p.name}, {unit_of(p.name)}".removesuffix(", "), yticks=[])
        panel.set_ylim(bottom=0.0)
        panel.spines[["top", "right", "left"]].set_visible(False)
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside upper center", ncols=4, frameon=False)
    return figure


def _density(draws: NDArray[Any], lower: float, upper: float) -> tuple[NDArray[Any], NDArray[Any]]:
    """Gaussian kernel density estimate of draws, mirrored at the bounds so that no mass leaks out."""
    low, high = np.quantile(draws, (_TAIL, 1.0 - _TAIL))
    # Silverman's rule, with the smaller of two measures of width
    width = min(draws.std(), (np.quantile(draws, 0.75) - np.quantile(draws, 0.25)) / 1.34)
    # repeated draws do not narrow the kernel
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
