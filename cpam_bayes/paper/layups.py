"""Table 9: constants and stacking sequences that the paper identified together."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib.resources import files


@dataclass(frozen=True, slots=True)
class IdentifiedLayup:
    """One specimen of Table 9.

    constants : by name with unit, as in plate files, in the digits of the print; empty where part (a) has
    no row of its own (F1, F2, G1, G2).
    angles_deg : the unknown plies of part (b), outermost first.
    """

    specimen: str
    constants: Mapping[str, str]
    angles_deg: tuple[int, ...]


@cache
def identified_layups() -> Mapping[str, IdentifiedLayup]:
    """Table 9 by specimen, in the order of part (b)."""
    resource = files("cpam_bayes") / "data" / "paper" / "table_9.toml"
    content = tomllib.loads(resource.read_text(encoding="utf-8"))
    return {
        name: IdentifiedLayup(
            specimen=name,
            constants=dict(zip(content["constants"], content["identified"].get(name, ()), strict=False)),
            angles_deg=tuple(angles),
        )
        for name, angles in content["sequence_deg"].items()
    }
