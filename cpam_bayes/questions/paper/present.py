"""The report of the comparison with the paper, from its JSON document: screen, page, Markdown.

`docs/comparison.md` is the `page` of a saved document.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from operator import itemgetter
from typing import Any, Final

from cpam_bayes.formatting import listed, signed, significant
from cpam_bayes.printed.tables import AGREEMENTS
from cpam_bayes.questions.paper.drawings import OF_THE_PAPER, drawings
from cpam_bayes.questions.paper.plates import claimed, diagnosed, wrong_plates
from cpam_bayes.questions.paper.rows import (
    AGREES,
    BUILT_IN,
    INPUT,
    NOT_COMPUTED,
    NOT_REPRODUCIBLE,
    UNDETERMINED,
    UNTOLD,
    VERDICTS,
    WITHIN,
    Record,
)
from cpam_bayes.render.report import (
    COMPUTATION,
    Column,
    Report,
    Rows,
    Section,
    Summary,
    remarks,
)
from cpam_bayes.render.terminal import duration

_FREQUENCY_TABLES: Final = (1, 5)


def _of(
    key: str, heading: str | None = None, text: Callable[[Any], str] = str, *, number: bool = False
) -> Column:
    return Column(heading, key, itemgetter(key), text, number)


def _shown(heading: str, value: Callable[[Any], Any], *, number: bool = False) -> Column:
    return Column(heading, None, value, number=number)


_TWO_DIGITS, _THREE_DIGITS = (partial(significant, digits=n) for n in (2, 3))
_ONE_DECIMAL: Final = partial(signed, decimals=1)


def _ours(row: Record) -> str | None:
    ours = row["ours"]
    if isinstance(ours, list):
        return "/".join(f"{angle:g}" for angle in ours)
    return None if ours is None else significant(ours, 5 if row["table"] in _FREQUENCY_TABLES else 4)


def _printed(row: Record) -> str:
    """The printed text; angles in the notation of ours."""
    text: str = row["printed_text"]
    return text.strip("[]").replace(", ", "/") if row["quantity"] == "angles_deg" else text


def _plain_ours(row: Record) -> float | str | None:
    """Our value; angles as one text, for a CSV file."""
    ours: float | list[float] | None = row["ours"]
    return "/".join(f"{angle:g}" for angle in ours) if isinstance(ours, list) else ours


def _interval(row: Record) -> str | None:
    low, high = row["q025"], row["q975"]
    return None if low is None or high is None else f"{significant(low)} to {significant(high)}"


_VALUES: Final = (
    _of("table"),
    _of("part"),
    _of("specimen", "specimen"),
    _of("source", "by"),
    _of("quantity", "quantity"),
    _of("printed"),
    _shown("printed", _printed, number=True),
    Column(None, "ours", _plain_ours),
    _shown("ours", _ours, number=True),
    _of("difference_percent", "difference %", _ONE_DECIMAL, number=True),
    _of("q025"),
    _of("q975"),
    _shown("95 % interval", _interval),
)


def _detail(key: str, row: Record) -> float | None:
    found: float | None = row["details"].get(key)
    return found


_SOLVERS: Final = ("ritz_hz", "fem_hz", "calculix_hz")
_ROWS: Final = (
    *_VALUES,
    *(Column(None, key, partial(_detail, key)) for key in _SOLVERS),
    _of("verdict", "verdict"),
)


def _outside(row: Record) -> str | None:
    """Short reason why ours lies outside its own interval; None where it does not.

    It is a mean of inversions of noisy lists, is on a bound or on E1 = E2, or eq. (7) gives high modes the
    most weight.
    """
    low, high, ours = row["q025"], row["q975"], row["ours"]
    if low is None or high is None or low <= ours <= high:
        return None
    if "repetition_sd" in row["details"]:
        return "noisy lists"
    return "on a bound" if row["details"]["on_bound"] else "high modes"


_BRIEF: Final = (
    *_VALUES,
    _shown("why ours is outside", _outside),
    _of("verdict_kind", "verdict"),
)


def _is_disputed(row: Record) -> bool:
    return row.get("verdict_kind") == NOT_REPRODUCIBLE


def row_table(document: Record) -> Rows:
    """The rows of all tables."""
    return Rows("rows", _ROWS, tuple(document["rows"]))


def _rows_of(document: Record, number: int, columns: tuple[Column, ...] = _ROWS) -> Rows:
    """The computed rows of a table."""
    rows = (row for row in document["rows"] if row["table"] == number and row["verdict"] != INPUT)
    return Rows("rows", columns, tuple(rows), _is_disputed)


def _count(of: str, kind: str) -> Column:
    return _shown(kind, lambda t: t[of].get(kind) or None, number=True)


_TABLES: Final = (
    _of("table", "table", number=True),
    _of("title", "title"),
    *(_count("verdicts", verdict) for verdict in VERDICTS),
)
_MISFITS: Final = (
    _of("table", "table", number=True),
    _of("specimen", "specimen"),
    _of("case", "constants"),
    _of("source", "by"),
    _of("objective", "F", significant, number=True),
    _of("our_objective", "smallest F", significant, number=True),
    _of("rms_percent", "rms %", _THREE_DIGITS, number=True),
    _of("our_rms_percent", "rms % at the smallest F", _THREE_DIGITS, number=True),
    _shown("swarms that found it", lambda m: f"{m['swarms_found']} of {m['swarms']}", number=True),
    _of("swarms"),
    _of("swarms_found"),
    _of("swarms_converged", "swarms converged", number=True),
    _of("on_bounds", "on a bound or E1 = E2", ", ".join),
)


def _case(misfit: Record) -> str:
    """The plate, with the choice of unknowns where there is one."""
    return str(misfit["specimen"]) + ("" if misfit["case"] == BUILT_IN else f", {misfit['case']}")


_OF_A_PAGE: Final = frozenset({"rms_percent", "our_rms_percent", "on_bounds"})
_OWN_MISFITS: Final = (
    _shown("specimen", _case),
    *(column for column in _MISFITS if column.key in _OF_A_PAGE),
)
_SIMULATION: Final = (
    _of("table", "table", number=True),
    _of("specimen", "plate"),
    _of("printed_rms_percent", "printed rms %", _THREE_DIGITS, number=True),
    _of("plain_rms_percent", "plain rms %", _THREE_DIGITS, number=True),
    _of("claim"),
    _of("sentence"),
    _of("causes"),
    _of("sizes"),
    _shown("claim", claimed),
    _of("probability", "probability", "{:.2f}".format, number=True),
    _of("extended_rms_percent", "extended rms %", _THREE_DIGITS, number=True),
    _of("log_bayes_factor", "log Bayes factor", _ONE_DECIMAL, number=True),
    _of("held_out"),
    _of("held_out_se"),
    _of("frequency_ratio", "measured over printed plate", _THREE_DIGITS, number=True),
    _of("scaled_rms_percent", "rms % after this factor", _TWO_DIGITS, number=True),
    _shown(
        "frequencies left out",
        lambda e: None if e["held_out"] is None else f"{signed(e['held_out'], 1)} +- {e['held_out_se']:.1f}",
        number=True,
    ),
)
_COSTS: Final = (
    _of("specimen", "plate"),
    _of("case", "constants"),
    _of("forward_solves", "forward solves", number=True),
    _of("seconds", "seconds", "{:.1f}".format, number=True),
    _of("calculix_seconds", "seconds of one CalculiX run", "{:.1f}".format, number=True),
    _of("calculix_hours", "CalculiX hours", "{:.0f}".format, number=True),
)
_PERCENTAGES: Final = (
    _of("table", "table", number=True),
    _of("specimen", "specimen"),
    _of("source", "by"),
    _of("quantity", "quantity"),
    _of("printed_percent", "printed %", "{:g}".format, number=True),
    _of("recomputed_percent", "recomputed %", "{:.1f}".format, number=True),
    _of("possible_percent", "possible %", lambda ends: " to ".join(f"{v:.1f}" for v in ends)),
    _of("agreement"),
)


def _by_ply(key: str, form: str, row: Record) -> str:
    """A detail of each unknown ply, the outermost first."""
    return " ".join(format(v, form) for name, v in row["details"].items() if name.startswith(key))


_NOISY_ANGLES: Final = (
    _of("specimen", "plate"),
    _of("source", "noise"),
    _shown("spread by ply, degrees", partial(_by_ply, "spread_", ".0f")),
    _of("verdict_kind", "verdict"),
    _shown("bits by ply", partial(_by_ply, "bits_", ".1f")),
)
_COMPUTED: Final = (
    _shown("what", lambda r: r[0]),
    _shown("version", lambda r: str(r[1]["version"])),
    _shown("sources", lambda r: str(r[1].get("fingerprint", ""))),
    _shown("date", lambda r: str(r[1]["date"])),
    _shown("seconds", lambda r: f"{r[1]['seconds']:.0f}", number=True),
)


def _well_posed(conditions: Sequence[Record]) -> Rows:
    names = dict.fromkeys(name for c in conditions for name in c["percent_per_percent"])
    stability = (
        _shown(f"{name.partition('_')[0]}, % per %", partial(_amplified, name), number=True) for name in names
    )
    every = (
        _of("table", "table", number=True),
        _of("specimen", "specimen"),
        _shown("unknowns of frequencies", lambda c: f"{c['unknowns']} of {c['frequencies']}"),
        _of("left_percent", "left %", _TWO_DIGITS, number=True),
        _of("exists", "exists", lambda exists: "yes" if exists else "no"),
        _shown("rank", lambda c: f"{c['rank']} of {c['unknowns']}"),
        _of("condition", "condition number", _TWO_DIGITS, number=True),
        _of("optima", "optima", number=True),
        _of("layups", "stacking sequences", number=True),
    )
    return Rows("hadamard", (*every, *stability), tuple(conditions))


def _amplified(name: str, condition: Record) -> str | None:
    percent = condition["percent_per_percent"]
    if name not in percent:
        return None
    return "not determined" if percent[name] is None else significant(percent[name], 2)


def _wrong_percentages(document: Record) -> Rows:
    wrong = (p for p in document["audit"]["percentages"] if p["agreement"] == AGREEMENTS[-1])
    return Rows("percentages", _PERCENTAGES, tuple(wrong))


def report_of(document: Record, slips: tuple[str, ...], cautions: tuple[str, ...]) -> Report:
    """The report: rows of one table or verdicts on all, then the audit of the print."""
    numbers = [t["table"] for t in document["tables"]]
    tables, misfits = (
        Rows("tables", _TABLES, tuple(document["tables"])),
        Rows("misfits", _MISFITS, tuple(document["audit"]["misfits"])),
    )
    simulation = Rows("simulation", _SIMULATION, tuple(document["simulation"]))
    costs, well_posed = Rows("costs", _COSTS, tuple(document["costs"])), _well_posed(document["hadamard"])
    computed = Rows("computed", _COMPUTED, tuple(document["computed"].items()))
    shown = drawings(document)
    drawn = {drawing.name for drawing in shown}
    titles = {t["table"]: f"Table {t['table']}: {t['title']}" for t in document["tables"]}
    return Report(
        summary=Summary(
            title=f"paper {numbers[0]}" if len(numbers) == 1 else "paper",
            headline=_headline(document),
            tables=(_first_table(document, tables, titles),),
            lines=(
                *document["disagreements"][:1],
                *(("Computed with --quick: do not quote these numbers.",) if document["quick"] else ()),
                *_of_angles(document),
                *_when(document),
            ),
            next_step=_WHY if any(map(_is_disputed, document["rows"])) else "",
            slips=slips,
            warnings=cautions,
        ),
        sections=(
            Section("Largest disagreements", (remarks("Largest disagreements", document["disagreements"]),)),
            Section(
                "Table by table",
                tuple(_rows_of(document, n).table(titles[n]) for n in numbers),
                tuple(name for name in ("differences", "frequencies") if name in drawn),
                folded=False,
            ),
            Section(
                "Misfit of the printed constants",
                (misfits.table("Printed constants against their own frequencies, F in Hz2"),),
                tuple(name for name in ("misfits",) if name in drawn),
            ),
            Section(
                "Is the problem well posed",
                (well_posed.table("Existence, uniqueness, stability (Hadamard)"),),
            ),
            Section(
                "What the paper's simulation gets wrong",
                (simulation.table("The simulation, diagnosed against the measured frequencies"),),
            ),
            Section(
                "Audit of the print",
                (
                    _wrong_percentages(document).table("Percentages that cannot follow from their rows"),
                    remarks("Misprints and contradictions", document["audit"]["misprints"]),
                    remarks(
                        "What means of ten can show",
                        _on_noise(document["audit"]),
                    ),
                ),
            ),
            Section(COMPUTATION, (computed.table("Computations"), costs.table("Forward solves"))),
        ),
        document=document,
        drawings=shown,
        rows=(row_table(document), misfits, well_posed, simulation, costs),
    )


_WHY: Final = "why values are not reproducible: --verbose, or comparison.csv with --out DIR"


def _first_table(document: Record, tables: Rows, titles: Mapping[int, str]) -> Any:
    """The rows of one table, or the verdicts on several."""
    if len(titles) > 1:
        return tables.table("Printed values by verdict")
    ((number, title),) = titles.items()
    plates = {row["specimen"] for row in document["rows"]}
    columns = tuple(c for c in _BRIEF if c.key != "specimen" or len(plates) > 1)
    rows = _rows_of(document, number, columns)
    return (rows if rows.rows else Rows("rows", columns, tuple(document["rows"]))).table(title)


def _headline(document: Record) -> str:
    counts = {kind: sum(t["verdicts"][kind] for t in document["tables"]) for kind in VERDICTS}
    computed = sum(counts.values()) - counts[INPUT] - counts[NOT_COMPUTED]
    numbers = [t["table"] for t in document["tables"]]
    of = f"Table {numbers[0]}" if len(numbers) == 1 else f"{len(numbers)} tables"
    if not computed:
        return f"{of} holds inputs only: {counts[INPUT]} printed values, nothing to compute."
    agree = (
        f"{counts[AGREES]} of {computed} printed values of {of} {_verb(counts[AGREES], 'agrees', 'agree')}"
    )
    others = (
        (WITHIN, "lies", "lie", "within the 95 % interval or set"),
        (UNTOLD, "cannot", "cannot", "be told apart"),
        (UNDETERMINED, "is", "are", "not determined"),
        (NOT_REPRODUCIBLE, "is", "are", "not reproducible"),
        (NOT_COMPUTED, "was", "were", "not computed"),
    )
    said = [
        f"{counts[kind]} {_verb(counts[kind], one, many)} {what}"
        for kind, one, many, what in others
        if counts[kind] or kind == NOT_REPRODUCIBLE
    ]
    return f"{', '.join((agree, *said))}."


def _verb(n: int, one: str, many: str) -> str:
    return one if n == 1 else many


def _of_angles(document: Record) -> Iterator[str]:
    """Remark on a table with angles of noisy lists: what our values and intervals refer to."""
    if len(document["tables"]) == 1 and any(map(_has_spread, document["rows"])):
        yield (
            "Free disorder: constants of the known layup. Rows below it: ours are means of ten lists, angles "
            "searched too; intervals are over all layups of one list."
        )


def _has_spread(row: Record) -> bool:
    """Whether a row has the scatter of angles over noisy lists."""
    return "spread_1_deg" in row["details"]


def _when(document: Record) -> Iterator[str]:
    """Dates of the computations, and how to repeat them."""
    days = sorted({record["date"] for record in document["computed"].values()})
    if days:
        seconds = sum(record["seconds"] for record in document["computed"].values())
        when = " to ".join(dict.fromkeys((days[0], days[-1])))
        yield f"Computed {when}, {duration(seconds)} in all; --all recomputes."


def page(document: Record) -> str:
    """The page docs/comparison.md, from the document of `cpam-bayes paper --json`."""
    return "\n".join(_lines(document)).rstrip() + "\n"


def _lines(document: Record) -> Iterator[str]:
    audit = document["audit"]
    inputs = sum(row["verdict_kind"] == INPUT for row in document["rows"])
    yield from (
        "# The paper's tables, reproduced and audited",
        "",
        "Written by `python studies/19_paper.py`. Tables are of Masoumi and Ghasemi Ghalebahman (2017). "
        f"Of {len(document['rows'])} printed values {inputs} are inputs; the others are compared with "
        "computed ones in [comparison.csv](comparison.csv); `cpam-bayes paper N` shows one table. "
        f"{_computed(document['computed'])}",
        "",
        *wrong_plates(document),
        *_disagreements(document["disagreements"]),
    )
    yield from (
        "## Verdicts",
        "",
        "*Agrees*: a frequency to 0.5 % or half a unit of its last digit, an identified constant to 1 %, a "
        "mean of ten to two standard errors of the difference of two such means and to 5 %. *Cannot be told "
        "apart*: within the standard errors, but more than 5 % apart, or with a standard error above 5 %. "
        "*Within the posterior*: in the 95 % "
        "interval up to half a unit of the last printed digit, or in the 95 % set of stacking sequences. "
        "Where half or more of the ten inversions sit on a bound there is no standard error. *Not "
        "determined*: there is neither a standard error nor an interval, or the angles found show no "
        "preference. Inputs and references are not counted.",
        "",
    )
    counts = tuple(column for column in _TABLES if column.key != "title" and column.heading != INPUT)
    judged = (t for t in document["tables"] if sum(t["verdicts"].values()) > t["verdicts"].get(INPUT, 0))
    yield from _markdown(Rows("tables", counts, tuple(judged)))
    yield from (_by_author(document["tables"]), "")
    if audit["not_determined"]:
        yield from (audit["not_determined"], "")
    yield from _noise_lines(document)
    own = tuple(m for m in audit["misfits"] if m["source"] in OF_THE_PAPER)
    agreements = [p["agreement"] for p in audit["percentages"]]
    follows, before, never = (agreements.count(kind) for kind in AGREEMENTS)
    yield from (
        "## Audit of the print",
        "",
        f"Of {len(agreements)} printed percentages {follows} follow from the digits of their rows, {before} "
        f"can follow from values before rounding, and {never} cannot.",
        "",
    )
    yield from (f"- {note}" for note in audit["misprints"])
    yield from (
        "",
        "## Printed constants against their own frequencies",
        "",
        "F is eq. (7), in Hz², with the printed constants and layup; smallest F is the smallest that the "
        f"swarms found, with E1 > E2 of eq. (9) and within the bounds of eq. (8){_other_bounds(own)}. "
        f"{_of_one_swarm(own)}",
        "",
    )
    yield from _markdown(Rows("misfits", _OWN_MISFITS, own))
    yield from _hadamard_lines(document["hadamard"])
    yield from _diagnosed_lines(document["simulation"])
    yield from (f"- Warning: {text}" for text in document["warnings"])


def _computed(computed: Mapping[str, Record]) -> str:
    """Versions and dates of the computations behind the rows."""
    versions = sorted({str(record["version"]) for record in computed.values()})
    days = sorted({str(record["date"]) for record in computed.values()})
    if not days:
        return ""
    return f"Computed {' to '.join(dict.fromkeys((days[0], days[-1])))} by version {listed(versions, 'and')}."


def _disagreements(texts: Sequence[str]) -> Iterator[str]:
    if texts:
        yield from ("## The most important disagreements", "")
        yield from (f"{i}. {text}" for i, text in enumerate(texts, 1))
        yield ""


def _by_author(tables: Sequence[Record]) -> str:
    """Sentence on irreproducible values: the paper's own and those of works that it cites."""
    off, of_others = (
        sum(t[key][NOT_REPRODUCIBLE] for t in tables) for key in ("verdicts", "verdicts_of_others")
    )
    if not off:
        return ""
    return (
        f"Of {off} values that are not reproducible {off - of_others} are the paper's own and {of_others} of "
        "works that it cites."
    )


def _other_bounds(misfits: Sequence[Record]) -> str:
    """Bounds of the smallest F that differ from those of eq. (8), with the plates."""
    found: dict[tuple[str, float, float, str], list[str]] = {}
    for misfit in misfits:
        for name, (low, high) in misfit["beyond_eq_8"].items():
            found.setdefault((name, low, high, misfit["case"]), []).append(misfit["specimen"])
    each = "; ".join(
        f"{name.partition('_')[0]} from {low:g} to {high:g} GPa for {listed(plates, 'and')}"
        f"{'' if case == BUILT_IN else f' with {case}'}"
        for (name, low, high, case), plates in found.items()
    )
    return f", except {each}" if each else ""


def _of_one_swarm(misfits: Sequence[Record]) -> str:
    """Sentence on plates whose smallest F only one of several swarms found."""
    alone = [m for m in misfits if m["swarms"] > 1 and m["swarms_found"] <= 1]
    if not alone:
        return ""
    each = listed([f"{_case(m)} ({m['swarms_found']} of {m['swarms']})" for m in alone], "and")
    return f"Only one swarm found it on {each}: it may not be the smallest there."


def _diagnosed_lines(simulation: Sequence[Record]) -> Iterator[str]:
    if not simulation:
        return
    yield from (
        "## Diagnosis of every measured list",
        "",
        "For the answers see [findings](findings.md). Misfit is rms, with constants near the data sheet, and "
        "with the cause. The log Bayes factor (nats) is of the cause against none; the log score (nats) its "
        "gain on frequencies left out of the fit.",
        "",
    )
    yield from _markdown(diagnosed(simulation))


def _noise_lines(document: Record) -> Iterator[str]:
    texts = _on_noise(document["audit"])
    if not texts:
        return
    yield from ("## What means of ten can show", "", *(f"- {text}" for text in texts), "")
    rows = tuple(filter(_has_spread, document["rows"]))
    if rows:
        yield from ("Plies from the outermost to the innermost:", "")
        yield from _markdown(Rows("angles", _NOISY_ANGLES, rows))


def _on_noise(audit: Record) -> tuple[str, ...]:
    """Sentences on what means of ten and their angles can show."""
    return tuple(filter(None, (audit["means_of_ten"], *audit["angles"])))


def _hadamard_lines(conditions: Sequence[Record]) -> Iterator[str]:
    if not conditions:
        return
    roundings = [c["rounding_percent"] for c in conditions]
    least, most = min(roundings), max(roundings)
    exist, unique = ([c for c in conditions if c[key]] for key in ("exists", "unique"))
    yield from (
        "## Hadamard's conditions",
        "",
        "*Existence*: the root of the residual sum of squares over the degrees of freedom is at most "
        f"{conditions[0]['repeatability_percent']:.2g} %, the 97.5 % point of this package's prior of "
        "repeatability (the paper states none), plus, in quadrature, the rounding of the list, "
        f"{least:.1g} to {most:.1g} % (rms). "
        "*Uniqueness*: the sensitivities d ln f / d ln x have full rank, and no other optimum or stacking "
        "sequence (95 % set) fits within the noise. "
        f"Existence holds for {len(exist)} of {len(conditions)} choices of plate and unknowns"
        f"{_named(exist)}, uniqueness for {len(unique)}. *Stability*, what 1 % of "
        "noise does to each constant, is in the table of `cpam-bayes paper --verbose`.",
        "",
    )


def _named(conditions: Sequence[Record]) -> str:
    """The plates in parentheses."""
    named = dict.fromkeys(f"{c['specimen']} with {c['unknowns']} unknowns" for c in conditions)
    return f" ({'; '.join(named)})" if named else ""


def _markdown(rows: Rows) -> Iterator[str]:
    table = rows.table("")
    yield f"| {' | '.join(table.headings or ())} |"
    yield f"|{'---|' * len(table.columns)}"
    for row in table.rows:
        yield f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in row)} |"
    yield ""
