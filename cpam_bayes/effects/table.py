"""The catalogue as the table of docs/effects.md: ``python -m cpam_bayes.effects.table docs/effects.md``."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Sequence
from pathlib import Path

from cpam_bayes.effects import CATALOGUE
from cpam_bayes.effects.effect import Effect, scale_of
from cpam_bayes.parameters import Parameter

BEGIN, END = "<!-- catalogue -->", "<!-- end of the catalogue -->"
_HEAD = ("cause", "what it is", "of the", "1 sd", "up to", "how it enters")


def catalogue_table(effects: Sequence[Effect] = CATALOGUE) -> str:
    """A Markdown table: a cause a row, with its prior and how it enters."""
    return _table(_HEAD, map(_row, effects))


def _row(effect: Effect) -> tuple[str, ...]:
    # a size that follows the plate's has its words in the note
    of_plate = bool(effect.is_anywhere or effect.place) and effect.size_factor is not None
    sizes = ["of the plate" if of_plate else _size(p) for p in effect.sizes]
    ends = ["of the plate" if of_plate else _ends(p) for p in effect.sizes]
    texts = (", ".join(t) or "-" for t in (sizes, ends))
    return (effect.name, effect.title, effect.belongs_to, *texts, effect.note)


def _size(parameter: Parameter) -> str:
    unit, factor = parameter.display
    return f"{factor * scale_of(parameter):g} {unit}".rstrip()


def _ends(parameter: Parameter) -> str:
    unit, factor = parameter.display
    low, high = factor * parameter.prior.lower, factor * parameter.prior.upper
    text = f"{high:g}" if low == 0.0 else f"+-{high:g}" if low == -high else f"{low:g}, {high:g}"
    return f"{text} {unit}".rstrip()


def _table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    first, *others = (f"| {' | '.join(row)} |" for row in (head, *rows))
    return "\n".join((first, f"|{'---|' * len(head)}", *others))


if __name__ == "__main__":
    page = Path(sys.argv[1])
    before, _, rest = page.read_text(encoding="utf-8").partition(BEGIN)
    page.write_text(f"{before}{BEGIN}\n{catalogue_table()}\n{END}{rest.partition(END)[2]}", encoding="utf-8")
