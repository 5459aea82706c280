"""The question `plates`: the paper's specimens, which are built in."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Final

from cpam_bayes import __version__
from cpam_bayes.command import Command
from cpam_bayes.plate import Specimen, builtin_plates, to_user, user_name
from cpam_bayes.plate.edges import EDGE_KEY, PLACES
from cpam_bayes.render.plate import THIN, layup_text, size_text, thickness_class, thickness_ratio
from cpam_bayes.render.report import Column, Report, Rows, Summary
from cpam_bayes.result import Result, present


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class BuiltinPlates(Result):
    """The built-in specimens of the paper."""

    command: ClassVar[str] = "plates"

    specimens: tuple[Specimen, ...]


def plates() -> BuiltinPlates:
    """All built-in specimens, as the command `plates` lists them.

    Examples
    --------
    >>> import cpam_bayes as cb
    >>> print(cb.plates().summary().splitlines()[0])
    plates
    """
    return BuiltinPlates(seed=0, specimens=builtin_plates())


_COLUMNS: Final = (
    Column("name", "name", lambda s: s.name),
    Column(None, "specimen", lambda s: s.specimen),
    Column("size mm", None, lambda s: size_text(s.plate)),
    Column(None, "length_mm", lambda s: to_user("length", s.plate.length)),
    Column(None, "width_mm", lambda s: to_user("width", s.plate.width)),
    Column(None, "thickness_mm", lambda s: to_user("thickness", s.plate.thickness)),
    Column(None, "density_kg_m3", lambda s: s.plate.density),
    Column(None, "layup", lambda s: s.plate.layup.text),
    Column("layup", None, layup_text),
    Column("edges", "edges", lambda s: s.plate.edges),
    Column("material", "material", lambda s: s.material.name),
    Column(None, "isotropic", lambda s: s.material.isotropic),
    Column(None, "symmetry", lambda s: s.material.symmetry),
    Column(None, "unknowns", lambda s: [user_name(name) for name in s.unknowns.names]),
    Column("frequencies", "frequencies", lambda s: s.measurement.size if s.measurement else 0, number=True),
    Column(None, "thickness_class", lambda s: thickness_class(s.plate)),
    Column("class", None, lambda s: f"{thickness_class(s.plate)} ({thickness_ratio(s.plate)})"),
    Column(None, "notes", lambda s: list(s.notes)),
)


@present.register
def _present(result: BuiltinPlates) -> Report:
    rows = Rows("plates", _COLUMNS, result.specimens)
    return Report(
        summary=Summary(
            title="plates",
            headline=f"{len(result.specimens)} specimens of the paper are built in; name one as PLATE.",
            tables=(rows.table("Built-in specimens"),),
            lines=(
                f"Size: length x width x thickness. Edges at {', '.join(PLACES)}: {EDGE_KEY}.",
                f'Thick: 1/{THIN:.0f} of the shorter side or more. In a shell write "D&G" in quotes.',
            ),
            next_step="what are a specimen's constants?  cpam-bayes identify A1",
        ),
        document={"command": result.command, "version": __version__, "plates": rows.records()},
        rows=(rows,),
    )


COMMAND: Final = Command(plates, watched=False, seeded=False)
