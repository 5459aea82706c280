"""The noise study: rows, reasons of differences, comparison with the paper, figure."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from cpam_bayes.formatting import fixed, signed, significant, with_spread
from cpam_bayes.plate import to_user, unit_of, user_name
from cpam_bayes.printed.noise_study import Cell, Sensitivity, level_percent
from cpam_bayes.printed.repetition import Cause, Comparison
from cpam_bayes.printed.tables import PrintedTable, contradictions
from cpam_bayes.render.figures import new_figure
from cpam_bayes.render.report import Column

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Inversions behind each mean in the paper.
_PAPER_GROUPS: Final = 10


class ComparedRow(NamedTuple):
    """One constant at one level and reading, SI."""

    study: Sensitivity
    cell: Cell
    i: int
    table: PrintedTable | None

    @property
    def name(self) -> str:
        """Internal name, "E1"."""
        return self.study.without_noise.constants[self.i].name

    @property
    def value(self) -> float:
        """Value found without noise."""
        return self.study.without_noise.constants[self.i].value

    @property
    def comparison(self) -> Comparison:
        """Comparison of repetition and posterior."""
        return self.cell.comparisons[self.i]

    @property
    def printed(self) -> float | None:
        """The paper's percentage at this level, if any."""
        level = level_percent(self.cell.level)
        return None if self.table is None else self.table.percent_error(user_name(self.name), level)

    @property
    def printed_over_error(self) -> float | None:
        """The paper's percentage over the standard error of a mean of its ten inversions here."""
        sd = float(self.cell.repetition.sd[self.i])
        error = 100.0 * sd / math.sqrt(_PAPER_GROUPS) / abs(self.value)
        return None if self.printed is None or error == 0.0 else self.printed / error

    def user(self, values: Any) -> float:
        """One entry of SI values of the constants, in plate-file units."""
        return to_user(self.name, 1.0) * float(values[self.i])

    def spread(self, values: Any) -> float:
        """One entry of standard deviations of the constants, % of the value without noise."""
        return 100.0 * float(values[self.i]) / abs(self.value)

    def written(self, by: Any) -> tuple[str, str]:
        """Mean and standard deviation by repetition or posterior, as text."""
        return with_spread(self.user(by.mean), self.user(by.sd))


def _sd_ratio(ratio: float) -> str:
    return fixed(ratio, 2) if math.isfinite(ratio) else "-"


PLACE: Final = (
    Column(None, "level_percent", lambda r: level_percent(r.cell.level)),
    Column(None, "reading", lambda r: r.cell.reading),
    Column("name", "name", lambda r: r.name),
    Column("unit", None, lambda r: unit_of(r.name)),
    Column("no noise", None, lambda r: significant(to_user(r.name, r.value)), number=True),
)
COMPARED: Final = (
    Column("repetition", None, lambda r: r.written(r.cell.repetition)[0], number=True),
    Column("sd", None, lambda r: r.written(r.cell.repetition)[1], number=True),
    Column(None, "repetition_mean", lambda r: r.user(r.cell.repetition.mean)),
    Column(None, "repetition_sd", lambda r: r.user(r.cell.repetition.sd)),
    Column(
        "error %",
        "percent_error",
        lambda r: 100.0 / r.value * (float(r.cell.repetition.mean[r.i]) - r.value),
        lambda v: signed(v, 2),
        number=True,
    ),
    Column(
        "se %",
        "percent_standard_error",
        lambda r: 100.0 / r.value * r.comparison.standard_error,
        lambda v: significant(v, 2),
        number=True,
    ),
    Column("paper %", "paper_percent_error", lambda r: r.printed, lambda v: signed(v, 2), number=True),
    Column(None, "paper_in_standard_errors", lambda r: r.printed_over_error),
    Column("posterior", None, lambda r: r.written(r.cell.posterior)[0], number=True),
    Column("sd", None, lambda r: r.written(r.cell.posterior)[1], number=True),
    Column(None, "posterior_mean", lambda r: r.user(r.cell.posterior.mean)),
    Column(None, "posterior_sd", lambda r: r.user(r.cell.posterior.sd)),
    Column("sd ratio", "sd_ratio", lambda r: r.comparison.sd_ratio, _sd_ratio, number=True),
    Column(
        "both",
        "causes",
        lambda r: list(r.comparison.causes),
        lambda causes: f"differ: {', '.join(causes)}" if causes else "agree",
    ),
    Column(None, "means_agree", lambda r: r.comparison.means_agree),
    Column(None, "sds_agree", lambda r: r.comparison.sds_agree),
    Column(None, "shift_in_standard_errors", lambda r: r.comparison.shift),
    Column(None, "share_on_bound", lambda r: float(r.cell.repetition.on_bound[:, r.i].mean())),
    Column(None, "posterior_share_next_to_bound", lambda r: float(r.cell.posterior.next_to_bound[r.i])),
    Column(None, "posterior_skewness", lambda r: float(r.cell.posterior.skewness[r.i])),
    Column(None, "posterior_sd_over_prior_sd", lambda r: float(r.cell.posterior.contraction[r.i])),
    Column(None, "linearised_posterior_sd", lambda r: r.user(r.cell.posterior.linearised_sd)),
    Column(None, "linearised_repetition_sd", lambda r: r.user(r.cell.posterior.swarm_sd)),
    Column(None, "repetitions", lambda r: [r.user(each) for each in r.cell.repetition.constants]),
)


def noise_text(cell: Cell) -> str:
    """Level and reading in words."""
    sizes = {
        "relative": "of each frequency (relative)",
        "rms": f"of the rms frequency (rms), {significant(float(cell.noise_sd[0]), 3)} Hz for all modes",
    }
    return f"{level_percent(cell.level):g} % {sizes[cell.reading]}"


def difference_sentences(rows: Sequence[ComparedRow]) -> tuple[str, ...]:
    """One sentence for each difference at a constant, level and reading, with the numbers that explain it."""
    sentences = []
    for row in rows:
        comparison = row.comparison
        if not comparison.causes:
            continue
        what = []
        if not comparison.means_agree:
            what.append(f"means {significant(abs(comparison.shift), 2)} standard errors apart")
        if not comparison.sds_agree:
            what.append(f"sd {significant(comparison.sd_ratio, 2)} times the posterior's")
        why = "; ".join(_reason(row, cause) for cause in comparison.causes)
        level = f"{level_percent(row.cell.level):g} % {row.cell.reading}"
        sentences.append(f"{level}, {row.name}: {' and '.join(what)}: {why}.")
    return tuple(sentences)


def _reason(row: ComparedRow, cause: Cause) -> str:
    rep, post, i, groups = row.cell.repetition, row.cell.posterior, row.i, row.study.groups
    apart = significant(abs(float((row.value - post.best[i]) / post.sd[i])), 2)
    values: dict[Cause, str] = {
        "missed": f"the swarms of {rep.missed} of {groups} lists missed the minimum of eq. (7)",
        "bounds": (
            f"{int(rep.on_bound[:, i].sum())} of {groups} inversions end on a bound, where "
            f"{100 * float(post.next_to_bound[i]):.0f} % of the posterior lies"
        ),
        "open": (
            f"the noise leaves it open: the posterior's sd is {100 * float(post.contraction[i]):.0f} % of "
            "its prior's, and inversions know the bounds of a prior only"
        ),
        "optima": "the inversions or the posterior fall into separate groups",
        "skewed": f"the posterior is skewed ({fixed(float(post.skewness[i]), 1)})",
        "reordered": f"in {100 * rep.reordered:.0f} % of the noisy lists modes have changed places",
        "weights": (
            "eq. (7) does not weigh the frequencies by this noise, which widens the scatter "
            f"{significant(float(post.swarm_sd[i] / post.linearised_sd[i]), 2)} times to first order"
        ),
        "misfit": (
            "the model does not fit the list, and eq. (7) and the likelihood settle at constants "
            f"{apart} sd apart"
        ),
        "stopped": f"the swarm stops {apart} sd short of the optimum by its own tolerance, though it fits",
        "unexplained": "no measured cause explains it",
    }
    return values[cause]


def beside_paper(study: Sensitivity, table: PrintedTable | None) -> tuple[str, ...]:
    """Sentences on the printed percentages beside the scatter of a mean of ten, and on contradictions."""
    if table is None:
        return ()
    n = len(study.without_noise.constants)
    sentences = [
        f"Table {table.number}: noise on the measured list, errors against the paper's own noise-free answer."
    ]
    if "angles_deg" in table.columns:
        sentences.append("The paper sought the ply angles too; here the layup is known.")
    for reading in dict.fromkeys(cell.reading for cell in study.cells):
        rows = [
            ComparedRow(study, c, i, table) for c in study.cells if c.reading == reading for i in range(n)
        ]
        ratios = [row.printed_over_error for row in rows if row.printed_over_error is not None]
        if ratios:
            rms = significant(float(np.sqrt(np.mean(np.square(ratios)))), 2)
            below = int(np.sum(np.abs(ratios) < 1.0))
            sentences.append(
                f"{reading}: {below} of {len(ratios)} printed percentages are smaller than the standard "
                f"error that a mean of ten inversions has here; in these units their rms is {rms}, where "
                "chance alone gives about 1."
            )
    sentences += [
        f"{c.column} at {c.row.level_percent:g} %: the printed {c.printed} % does not follow from its row, "
        f"whose amounts allow {c.lowest:.1f} to {c.highest:.1f} %."
        for c in contradictions(table)
    ]
    return tuple(sentences)


_READING_COLOURS: Final = {"relative": "#1f5f8b", "rms": "#c1440e"}
# Markers and words of the legend.
_MARKS: Final = (
    ("o", "inversions: mean, sd (bar), standard error of the mean (thick)"),
    ("s", "posterior: mean and sd"),
    ("x", "printed in the paper"),
)


def draw_constant(axes: Axes, document: Mapping[str, Any], name: str) -> None:
    """Draw one constant at all levels: differences from the inversion without noise, %."""
    reference = document["without_noise"]["constants"][name]["value"]
    readings = list(document["levels"][0]["readings"])
    for i, level in enumerate(document["levels"]):
        for j, reading in enumerate(readings):
            values = level["readings"][reading]["constants"][name]
            colour = _READING_COLOURS[reading]
            place = i + (j - (len(readings) - 1) / 2) * 0.44
            for kind, shift in (("repetition", -0.09), ("posterior", 0.09)):
                centre = 100.0 * (values[f"{kind}_mean"] / reference - 1.0)
                spread = 100.0 * values[f"{kind}_sd"] / reference
                open_mark = kind == "posterior"
                axes.errorbar(
                    place + shift,
                    centre,
                    spread,
                    fmt="s" if open_mark else "o",
                    color=colour,
                    markerfacecolor="white" if open_mark else colour,
                    markersize=3.5,
                    linewidth=0.9,
                    capsize=1.5,
                )
            axes.errorbar(
                place - 0.09,
                values["percent_error"],
                values["percent_standard_error"],
                fmt="none",
                ecolor=colour,
                elinewidth=2.6,
            )
        printed = level["constants"][name]["paper_percent_error"]
        if printed is not None:
            axes.plot(i, printed, "x", color="black", markersize=6, zorder=3)
    axes.axhline(0.0, color="0.6", linewidth=0.8, zorder=0)
    axes.set_xticks(range(len(document["levels"])), [f"{v['level_percent']:g}" for v in document["levels"]])
    axes.set_xlim(-0.6, len(document["levels"]) - 0.4)
    constant, _, unit = name.partition("_")
    axes.set_title(f"{document['plate']}: {constant} = {reference:.4g} {unit}".rstrip(), fontsize="medium")


def legend_entries(readings: Sequence[str]) -> list[Any]:
    """Legend handles of markers and colours."""
    from matplotlib.lines import Line2D

    marks = [
        Line2D([], [], color="0.2", linestyle="none", marker=mark, markersize=5, label=words)
        for mark, words in _MARKS
    ]
    marks[1].set_markerfacecolor("white")
    colours = {"relative": "relative: sd a fraction of each frequency", "rms": "rms: one sd for all modes"}
    return marks + [
        Line2D([], [], color=_READING_COLOURS[r], linewidth=3, label=colours[r]) for r in readings
    ]


def sensitivity_figure(document: Mapping[str, Any]) -> Figure:
    """Repetition and posterior of every constant at every level, from a JSON document."""
    names = list(document["without_noise"]["constants"])
    figure = new_figure(max(8.4, 2.6 * len(names) + 0.6), 4.2)
    grid = np.atleast_1d(figure.subplots(1, len(names)))
    for axes, name in zip(grid, names, strict=True):
        draw_constant(axes, document, name)
        axes.set_xlabel("noise, %")
    grid[0].set_ylabel("difference from the inversion\nwithout noise, %")
    handles = legend_entries(list(document["levels"][0]["readings"]))
    figure.legend(handles=handles, loc="outside lower center", ncols=2, fontsize="small", frameon=False)
    return figure
