"""The catalogue as the tables of docs/effects.md: ``python -m cpam_bayes.effects.table docs/effects.md``."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Sequence
from pathlib import Path

from cpam_bayes.effects import CATALOGUE
from cpam_bayes.effects.effect import Effect, scale_of
from cpam_bayes.parameters import Parameter

BEGIN, END = "<!-- catalogue -->", "<!-- end of the catalogue -->"
_SIGNS = {1: "rise", -1: "fall", 0: "either"}
_RECORD = ("cause", "what it is", "family", "of the", "parameter", "1 sd", "up to", "frequencies", "not with")
_NOTES = ("cause", "how it enters", "what to check in the laboratory")


def catalogue_tables(effects: Sequence[Effect] = CATALOGUE) -> str:
    """Two Markdown tables: the records, and how effects enter with what to check."""
    notes = ((e.name, e.note, e.check) for e in effects)
    return f"{_table(_RECORD, map(_record, effects))}\n\n{_table(_NOTES, notes)}"


def _record(effect: Effect) -> tuple[str, ...]:
    sized = effect.sizes
    parameters = [f"{p.name}{' >= 0' if p.prior.lower >= 0.0 else ''}" for p in sized]
    parameters += [p.name for p in effect.coordinates]
    # a size that follows the plate's has its words in the note
    of_plate = effect.is_anywhere and effect.size_factor is not None
    sizes = ["of the plate" if of_plate else _size(p) for p in sized]
    ends = ["of the plate" if of_plate else _ends(p) for p in sized]
    others = [name for name in effect.excludes if name != effect.name]
    texts = (", ".join(t) or "-" for t in (parameters, sizes, ends))
    sign = _SIGNS[effect.sign] if effect.parameters else "-"
    of = (effect.name, effect.title, effect.family, effect.belongs_to)
    return (*of, *texts, sign, ", ".join(others) or "-")


def _size(parameter: Parameter) -> str:
    unit, factor = parameter.display
    return f"{factor * scale_of(parameter):g} {unit}".rstrip()


def _ends(parameter: Parameter) -> str:
    unit, factor = parameter.display
    low, high = factor * parameter.prior.lower, factor * parameter.prior.upper
    text = f"{high:g}" if low == 0.0 else f"+-{high:g}" if low == -high else f"{low:g}, {high:g}"
    return f"{text} {unit}".rstrip()


def _table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    return "\n".join(f"| {' | '.join(row)} |" for row in (head, ["---"] * len(head), *rows))


if __name__ == "__main__":
    page = Path(sys.argv[1])
    before, _, rest = page.read_text(encoding="utf-8").partition(BEGIN)
    page.write_text(f"{before}{BEGIN}\n{catalogue_tables()}\n{END}{rest.partition(END)[2]}", encoding="utf-8")
