"""Edge conditions: one table of their names, the fields they hold at zero, and how they are drawn.

A new condition is one row of the table, with a new mark only where no existing one suits it.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Final, Literal

Field = Literal["u", "v", "w", "phi_x", "phi_y"]
FIELDS: Final[tuple[Field, ...]] = ("u", "v", "w", "phi_x", "phi_y")
# The edges in the order of their letters: by name in meshes and forms, and by place.
EDGES: Final = ("x0", "y0", "x1", "y1")
PLACES: Final = ("x = 0", "y = 0", "x = length", "y = width")


@dataclass(frozen=True, slots=True)
class EdgeCondition:
    """The support of one edge.

    name : in words; "" for one that no plate file states
    held_x, held_y : fields at zero on an edge x = constant, and on an edge y = constant
    sprung : fields on springs, supplied by a term of an effect
    is_clamp : a rigid or an elastic clamp
    mark : how a drawing shows it
    caption : explanation of that mark
    brick_widths : of the elements at the edge, in thicknesses, from the edge inwards. Clamped bricks are 0.3
        to 0.4 % too stiff with elements of 7 thicknesses there, and within 0.01 % of their limit with these
    """

    name: str
    held_x: tuple[Field, ...]
    held_y: tuple[Field, ...]
    sprung: tuple[Field, ...] = ()
    is_clamp: bool = False
    mark: Literal["line", "triangles", "hatching"] = "line"
    caption: str = ""
    brick_widths: tuple[float, ...] = ()

    def held(self, edge: str) -> tuple[Field, ...]:
        """Fields at zero on an edge, named as in `EDGES` or by its axis."""
        return self.held_x if edge[0] == "x" else self.held_y

    @property
    def is_free(self) -> bool:
        """Whether nothing is held."""
        return not (self.held_x or self.held_y or self.sprung)

    @property
    def follows_axis(self) -> bool:
        """Whether what is held depends on the edge's direction, so that the edge must lie along an axis."""
        return self.held_x != self.held_y


CONDITIONS: Final[Mapping[str, EdgeCondition]] = MappingProxyType(
    {
        "F": EdgeCondition("free", (), (), brick_widths=(3.0,)),
        # The hard simple support of Navier's solution: the tangential displacement and the tangential
        # rotation are held, the normal ones free.
        "S": EdgeCondition(
            "simply supported",
            ("v", "w", "phi_y"),
            ("u", "w", "phi_x"),
            mark="triangles",
            caption="edges on triangles are simply supported",
        ),
        "C": EdgeCondition(
            "clamped",
            FIELDS,
            FIELDS,
            is_clamp=True,
            mark="hatching",
            caption="hatched edges are clamped",
            brick_widths=(0.5, 1.0),
        ),
        # A simple support on springs in the transverse direction.
        "W": EdgeCondition("", ("v", "phi_y"), ("u", "phi_x"), ("w",)),
        # Elastic clamps: in rotation, in translation, in both.
        "R": EdgeCondition("", ("u", "v", "w"), ("u", "v", "w"), ("phi_x", "phi_y"), is_clamp=True),
        "T": EdgeCondition("", ("phi_x", "phi_y"), ("phi_x", "phi_y"), ("u", "v", "w"), is_clamp=True),
        "E": EdgeCondition("", (), (), FIELDS, is_clamp=True),
    }
)
"""Letter -> condition."""

STATED: Final = "".join(letter for letter, condition in CONDITIONS.items() if condition.name)
EDGE_KEY: Final = ", ".join(f"{letter} {CONDITIONS[letter].name}" for letter in STATED)
ALL_FREE: Final = "FFFF"
CANTILEVER: Final = "CFFF"


def conditions(edges: str) -> tuple[EdgeCondition, EdgeCondition, EdgeCondition, EdgeCondition]:
    """The conditions of the four edges, in the order of `EDGES`."""
    x0, y0, x1, y1 = (CONDITIONS[letter] for letter in edges)
    return x0, y0, x1, y1


def is_stated(edges: str) -> bool:
    """Whether a plate file may state this text: four letters of `STATED`."""
    return len(edges) == len(EDGES) and set(edges) <= set(STATED)


_WORDS: Final[Mapping[str, str]] = {
    **{letter.casefold(): letter for letter in STATED},
    **{CONDITIONS[letter].name: letter for letter in STATED},
    "frei": "F",
    "libre": "F",
    "supported": "S",
    "fixed": "C",
}


def letters_of(said: Any) -> Any:
    """Edge letters from words, from lower-case or separated letters, or from a list; anything else unchanged.

    A single word applies to all four edges.
    """
    if isinstance(said, str):
        text = re.sub(r"^all (edges )?", "", said.casefold().strip(" "))
        if text in _WORDS and text not in tuple(STATED.casefold()):
            return _WORDS[text] * len(EDGES)
        parts = re.split(r"[ ,;/|-]+", text)
        parts = list(text) if len(parts) == 1 else parts
    else:
        parts = [str(part).casefold() for part in said] if isinstance(said, list) else []
    letters = "".join(_WORDS.get(part, "?") for part in parts)
    return letters if is_stated(letters) else said


def yielding(letter: str, fields: tuple[Field, ...]) -> str | None:
    """The condition with ``fields`` on springs instead of held; None where it does not hold all of them."""
    before, taken = CONDITIONS[letter], set(fields)
    if not taken <= set(before.held_x) & set(before.held_y):
        return None
    wanted = (set(before.held_x) - taken, set(before.held_y) - taken, set(before.sprung) | taken)
    for other, after in CONDITIONS.items():
        if (set(after.held_x), set(after.held_y), set(after.sprung)) == wanted:
            return other
    return None
