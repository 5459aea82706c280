"""The answer of `export`: what was written where."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cpam_bayes.forward_model.calculix import Deck, Element
from cpam_bayes.plate import Specimen
from cpam_bayes.report.documents import plate_keys
from cpam_bayes.report.plates import plate_head
from cpam_bayes.report.tables import Table, facts

__all__ = ["WrittenDeck", "deck_document", "deck_screen"]

_TYPE: dict[Element, str] = {"shell": "S8R", "brick": "C3D20R"}


@dataclass(frozen=True, slots=True, eq=False)
class WrittenDeck:
    """A deck in its file; n_modes : deformation modes that its step asks for."""

    specimen: Specimen
    path: Path
    element: Element
    n_modes: int
    deck: Deck

    @property
    def n_elements(self) -> int:
        """Elements of the plate, known masses not counted."""
        layers, in_plane, _ = self.deck.mesh.elements.shape
        return int(layers * in_plane)


def deck_document(written: WrittenDeck, target: str, seed: int) -> dict[str, Any]:
    """The JSON document of `export`."""
    return {
        **plate_keys("export", written.specimen, seed),
        "to": target,
        "path": str(written.path),
        "element": written.element,
        "element_type": _TYPE[written.element],
        "nodes": len(written.deck.mesh.nodes),
        "elements": written.n_elements,
        "masses": len(written.specimen.sensors),
        "modes": written.n_modes,
        "rigid_body_motions": written.deck.n_rigid,
    }


def deck_screen(written: WrittenDeck) -> tuple[Table, ...]:
    """Plate, and what its file holds."""
    n_rigid = written.deck.n_rigid
    told = (
        ("file", str(written.path)),
        ("format", "ABAQUS input, read by ABAQUS and CalculiX; N, m, kg, s"),
        ("elements", f"{written.n_elements} of {_TYPE[written.element]}, {written.element}s"),
        ("nodes", str(len(written.deck.mesh.nodes))),
        ("step", f"{written.n_modes + n_rigid} modes: {written.n_modes} and {n_rigid} rigid-body motions"),
    )
    return plate_head(f"export {written.specimen.name}", written.specimen), facts("Written", told)
