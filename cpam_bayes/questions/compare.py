"""The question `compare`: the constants of two plates against each other."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Final

import numpy as np

from cpam_bayes import __version__
from cpam_bayes.answer import Notice
from cpam_bayes.batches.plate_row import PlateRow
from cpam_bayes.command import Command, option
from cpam_bayes.errors import checked
from cpam_bayes.formatting import listed, with_spread
from cpam_bayes.plate import PlateLike, read_plate, to_user, unit_of, user_name
from cpam_bayes.questions.batch import batch
from cpam_bayes.questions.batch.result import probability_text
from cpam_bayes.questions.batch.verdicts import slip_question
from cpam_bayes.render.report import Column, Report, Rows
from cpam_bayes.result import Result, present, within_time
from cpam_bayes.running import SILENT, Watch

_DRAWS: Final = 40_000
_LARGER: Final = "probability_larger"
# Two constants differ from this probability that one is larger, as for a 95 % interval.
_SURE: Final = 0.975


@dataclass(frozen=True, slots=True)
class Difference:
    """A constant of the second plate against that of the first.

    percent, sd_percent : second / first - 1 in percent, median and standard deviation
    probability_larger : probability that the second is larger
    is_open : whether the frequencies of one of the plates leave the constant open
    """

    name: str
    percent: float
    sd_percent: float
    probability_larger: float
    is_open: bool

    @property
    def differs(self) -> bool:
        """Whether the 95 % interval excludes zero."""
        return not self.is_open and not 1.0 - _SURE < self.probability_larger < _SURE


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class CompareResult(Result):
    """The differences of the constants of two plates; rows : both plates, as in `batch`."""

    command: ClassVar[str] = "compare"

    rows: tuple[PlateRow, PlateRow]
    differences: Mapping[str, Difference]

    @property
    def title(self) -> str:
        """The names of both plates."""
        return " ".join(row.name for row in self.rows)


@checked
@within_time
def compare(a: PlateLike, b: PlateLike, *, seed: int = 0, watch: Watch = SILENT) -> CompareResult:
    """Differences of the constants of plate b from those of plate a, with their probabilities.

    Each plate has the normal posterior of `batch`, errors of sizes included. The two are taken as
    independent: an error common to both, such as the scale of one analyser, is in their intervals and not in
    their difference. A plate whose prior is the posterior of an earlier plate gets a notice.

    Parameters
    ----------
    a, b : each a built-in name, a path, a table or a `Specimen`, see `read_plate`
    watch : progress display; none if left out

    Raises
    ------
    ValueError
        If one of the plates cannot be computed, or they have no unknown in common.

    Examples
    --------
    >>> import cpam_bayes as cb
    >>> found = cb.compare("A1", "A2").differences["E1"]
    >>> round(found.percent), found.probability_larger < 0.05
    (-3, False)
    """
    both = batch(a, b, seed=seed, watch=watch)
    for row in both.failed:
        raise ValueError(row.message)
    first, second = both.rows
    rng = np.random.default_rng([seed, 23])
    differences = {
        c.name: _difference(c.name, first, second, rng)
        for c in first.constants
        if second.constant(c.name) is not None
    }
    if not differences:
        raise ValueError(f"compare: {first.name} and {second.name} have no unknown constant in common")
    notices = (*both.notices, *_with_former_plate(a, b))
    return CompareResult(seed=seed, notices=notices, rows=(first, second), differences=differences)


def _with_former_plate(*plates: PlateLike) -> tuple[Notice, ...]:
    """Notice of plates whose prior is the posterior of an earlier plate, perhaps of the other one."""
    read = [read_plate(plate) for plate in plates]
    names = tuple(s.name for s in read if any(p.coupled is not None for p in s.unknowns.parameters))
    return (Notice("prior_of_former_plate", facts={"plates": names}),) if names else ()


def _difference(name: str, first: PlateRow, second: PlateRow, rng: np.random.Generator) -> Difference:
    a, b = first.constant(name), second.constant(name)
    assert a is not None
    assert b is not None
    x, y = (c.posterior.draws(rng, _DRAWS) for c in (a, b))
    ratio = y / x - 1.0
    low, middle, high = np.quantile(ratio, (0.16, 0.5, 0.84))
    return Difference(
        name,
        100.0 * float(middle),
        50.0 * float(high - low),
        float(np.mean(y > x)),
        a.is_open or b.is_open,
    )


@present.register
def _present(result: CompareResult) -> Report:
    first, second = result.rows
    table = Rows("differences", _columns(first, second), tuple(result.differences.values()))
    return Report(
        summary=result.screen(
            headline=_headline(result),
            tables=(table.table(""),),
            lines=(
                "The intervals contain noise, tolerances and data sheet of each plate, taken as independent.",
            ),
            next_step=_next_step(result),
        ),
        document={
            "command": result.command,
            "version": __version__,
            "seed": result.seed,
            "plates": [row.name for row in result.rows],
            "differences": {
                user_name(d.name): {
                    "percent": d.percent,
                    "sd_percent": d.sd_percent,
                    _LARGER: d.probability_larger,
                    "determined": not d.is_open,
                }
                for d in result.differences.values()
            },
            "warnings": list(result.warnings),
        },
        rows=(table,),
    )


def _columns(first: PlateRow, second: PlateRow) -> tuple[Column, ...]:
    return (
        Column("", "name", lambda d: d.name),
        Column(first.name, None, lambda d: first.constant(d.name), _value_text, number=True),
        Column(second.name, None, lambda d: second.constant(d.name), _value_text, number=True),
        Column("difference", None, _percent_text, number=True),
        Column(None, "percent", lambda d: d.percent),
        Column(None, "sd_percent", lambda d: d.sd_percent),
        Column(f"P({second.name} larger)", _LARGER, lambda d: d.probability_larger, probability_text, True),
        Column("", None, lambda d: "not determined" if d.is_open else "differ" if d.differs else ""),
    )


def _value_text(c: Any) -> str:
    value, sd = with_spread(to_user(c.name, c.value), to_user(c.name, c.sd))
    return f"{value} +- {sd} {unit_of(c.name)}".rstrip()


def _percent_text(d: Difference) -> str:
    value, sd = with_spread(d.percent, d.sd_percent)
    return f"{value if value.startswith('-') else f'+{value}'} +- {sd} %"


def _headline(result: CompareResult) -> str:
    wrong = [row for row in result.rows if not row.is_judged]
    if wrong:
        said = [row.name if row.slip is None else f"{row.name} ({slip_question(*row.slip)})" for row in wrong]
        return (
            f"Cannot be judged: the plate model does not describe the frequencies of {listed(said, 'and')}."
        )
    first, second = result.rows
    differing = [d for d in result.differences.values() if d.differs]
    if not differing:
        return f"No constant of {second.name} differs from that of {first.name} beyond its interval."
    said = [f"{d.name} by {_percent_text(d)}" for d in differing]
    return f"{second.name} differs from {first.name} in {listed(said, 'and')}."


def _next_step(result: CompareResult) -> str:
    """Next step: the cause of a misfit; a gauge where all moduli differ one way, as for a thinner plate."""
    for row in result.rows:
        if not row.is_judged:
            return f"what is wrong with {row.name}?  cpam-bayes diagnose {row.file}"
    moduli = [d for d in result.differences.values() if unit_of(d.name) and not d.is_open]
    if moduli and all(d.differs for d in moduli) and len({d.percent > 0.0 for d in moduli}) == 1:
        names = listed([row.name for row in result.rows], "and")
        return f"gauge {names}: 1 % error in thickness changes all moduli by 2 %, by 3 % if weighed."
    return f"which one agrees with the data sheet?  cpam-bayes batch {' '.join(r.file for r in result.rows)}"


COMMAND: Final = Command(
    compare,
    (
        option("a", metavar="A", help="built-in specimen or path of a plate file"),
        option("b", metavar="B", help="another one, to compare with A"),
    ),
)
