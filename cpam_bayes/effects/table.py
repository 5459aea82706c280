"""The catalogue as the table of docs/effects.md: ``python -m cpam_bayes.effects.table docs/effects.md``."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Final

from cpam_bayes.effects import CATALOGUE
from cpam_bayes.effects.effect import Effect, scale_of
from cpam_bayes.parameters import Parameter

BEGIN, END = "<!-- catalogue -->", "<!-- end of the catalogue -->"
_HEAD = ("cause", "what it is", "of the", "1 sd (gross)", "up to", "how it enters", "why; form error")
# Reasons of scales and limits. "Judged": no source was at hand.
_WHY: Final[Mapping[str, str]] = {
    "clamp_rotation": "judged; at the limit D11 / 2a, softer than the plate",
    "clamp_translation": "judged; at the limit 5 D11 / a^3, a cantilever has 3",
    "soft_clamp": "as the two above",
    "clamp_slip": "judged; beyond, it is another edge",
    "clamp_length": "judged: a ruler at the jaws; gross: a centimetre misread",
    "sensor_mass": "accelerometers are 1 to 10 % of a small plate; r of cubes of 2 to 5 g/cm3",
    "edge_mass": "plastic tape has 4 g/m; limit: a twentieth of the plate",
    "support": "judged; the model ends near 0.7 of the first frequency",
    "soft_support": "rubber 10 mm wide, 3 mm high under 3 mm of aluminium, 0.4 m long; 1 is no support",
    "air": "densities that rooms have, +-0.06",
    "thickness": "judged: another nominal thickness; limits a factor 2.5",
    "density": "judged: another material's; limits a fifth and three times",
    "length": "judged: a digit misread",
    "width": "judged: a digit misread",
    "swapped_sides": "no size",
    "frequency_scale": "judged: a wrong clock or line spacing",
    "taper_x": "judged; at the limit one edge is four times the other",
    "taper_y": "as taper_x",
    "skew": "judged: a saw without a square",
    "outline": "judged: any part of each square alike",
    "misorientation": "judged: a cut by hand; gross: a wrong axis",
    "outer_ply_angle": "judged: laid by hand; gross: a wrong ply",
    "inner_ply_angle": "judged: wide, as bending hardly shows it",
    "layup": "one step from the stated layup, no size",
    "warp": "judged: h / 4; beyond 4 h it is a shell",
    "membrane_stress": "judged; none under which the plate would buckle",
    "transverse_shear": "judged: within a factor of two of theory",
    "shear_ratio": "judged: within a factor of two of G12",
    "damage": "judged; at 95 % the plate is still one piece",
    "resin_skin": "judged, h / 40; resin: Daniel and Ishai, table A.2",
    "viscoelastic": "judged: losses of stiff laminates; a measured loss lowers it",
    "mode_identity": "judged: a tenth of these miss two modes",
    "outlier": "judged: a digit; a tenth stand in another mode's place",
    "material": "the wrong sheet: a tenth as probable as a family",
}


def catalogue_table(effects: Sequence[Effect] = CATALOGUE) -> str:
    """Markdown table with one cause per row: its prior, how it enters, and the reasons for its sizes."""
    return _table(_HEAD, map(_row, effects))


def _row(effect: Effect) -> tuple[str, ...]:
    # a size that scales with the plate is described in the note
    of_plate = bool(effect.is_anywhere or effect.place) and effect.size_factor is not None
    sizes = ["of the plate" if of_plate else _size(p) for p in effect.sizes]
    ends = ["of the plate" if of_plate else _ends(p) for p in effect.sizes]
    texts = (", ".join(t) or "-" for t in (sizes, ends))
    return (effect.name, effect.title, effect.belongs_to, *texts, effect.note, _reason(effect))


def _reason(effect: Effect) -> str:
    why = _WHY.get(effect.name, "-")
    return f"{why}; {effect.form_error:g}" if effect.form_error else why


def _size(parameter: Parameter) -> str:
    unit, factor = parameter.display
    text = f"{factor * scale_of(parameter):g} {unit}".rstrip()
    _, *gross = (part for _, part in parameter.prior.parts)
    wide = ("even" if part.is_range else f"{factor * part.typical:g} {unit}".rstrip() for part in gross)
    return " ".join((text, *(f"({scale})" for scale in wide)))


def _ends(parameter: Parameter) -> str:
    unit, factor = parameter.display
    low, high = factor * parameter.prior.lower, factor * parameter.prior.upper
    text = f"{high:.3g}" if low == 0.0 else f"+-{high:.3g}" if low == -high else f"{low:.3g}, {high:.3g}"
    return f"{text} {unit}".rstrip()


def _table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    first, *others = (f"| {' | '.join(row)} |" for row in (head, *rows))
    return "\n".join((first, f"|{'---|' * len(head)}", *others))


if __name__ == "__main__":
    page = Path(sys.argv[1])
    before, _, rest = page.read_text(encoding="utf-8").partition(BEGIN)
    page.write_text(f"{before}{BEGIN}\n{catalogue_table()}\n{END}{rest.partition(END)[2]}", encoding="utf-8")
