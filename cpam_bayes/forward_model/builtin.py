"""The built-in specimens: the question `plates`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from cpam_bayes.plate import Specimen, builtin_plates
from cpam_bayes.result import Result


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class BuiltinPlates(Result):
    """The specimens of the paper, as they are built in."""

    question: ClassVar[str] = "plates"
    command: ClassVar[str] = "plates"
    has_figures: ClassVar[bool] = False

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
