"""The paper's specimens, kept as plate files in the package."""

from __future__ import annotations

from importlib.resources import files
from typing import Final

from cpam_bayes.plate.parse import parse_specimen
from cpam_bayes.plate.records import Specimen

_NAMES: Final = (
    "D&G",
    *("A1", "A2", "B1", "B2", "C1", "C2", "C3", "C4"),
    *("D1", "D2", "D3", "D4", "F1", "F2", "G1", "G2"),
)


def builtin_names() -> tuple[str, ...]:
    """Names of the built-in specimens, as the paper has them."""
    return _NAMES


def builtin(name: str, sequence: bool = False) -> Specimen:
    """A built-in specimen: Tables 1 to 4 as printed, bounds of eq. (8).

    sequence : with the unknown angles of Table 9(b)
    raises ValueError for a name that is not in `builtin_names`
    """
    if name not in _NAMES:
        raise ValueError(f"built-in specimen: received {name!r}, accepted: {' '.join(_NAMES)}")
    resource = files("cpam_bayes") / "data" / "specimens" / f"{name.replace('&', '_and_')}.toml"
    text = resource.read_text(encoding="utf-8")
    specimen = parse_specimen(text, f"built-in {name}")
    return specimen.with_unknown_angles() if sequence else specimen
