"""A posterior as `identify --backend emcee --out DIR` stores it: draws in SI, and what they hold for."""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.forward_model.model import SIZES
from cpam_bayes.inference.posterior import NOISE_NAMES
from cpam_bayes.inference.sampling import opened_draws
from cpam_bayes.plate import USER_UNITS, joined_name, split_name, to_si, user_name
from cpam_bayes.plate.laminate import CONSTANTS

__all__ = ["StoredPosterior", "read_posterior", "stored_posterior"]

Array = NDArray[Any]

_KNOWN = (*CONSTANTS, *SIZES, *NOISE_NAMES)


@dataclass(frozen=True, slots=True)
class StoredPosterior:
    """Draws of the constants of a plate.

    source : the file, or the name of the plate
    draws : name -> (n_draws,) SI; constants, sizes and the noise, those that varied
    plate, specimen : names of the plate that was measured
    symmetry : of its material, "" where the file does not say
    held : constants that the plate file gave and that did not vary, SI
    repeatability : relative standard deviation of a measured frequency where it was given, else None
    outline : length, width and thickness of the plate file, m, as far as they are there
    """

    source: str
    draws: Mapping[str, Array]
    plate: str
    specimen: str
    symmetry: str
    held: Mapping[str, float]
    repeatability: float | None
    outline: Mapping[str, float] = field(default_factory=dict)

    @property
    def size(self) -> int:
        """Number of draws."""
        return len(next(iter(self.draws.values())))

    @property
    def constants(self) -> tuple[str, ...]:
        """The elastic constants among the draws."""
        return tuple(name for name in self.draws if split_name(name)[1] in CONSTANTS)

    @property
    def sizes(self) -> tuple[str, ...]:
        """The sizes of the measured plate among the draws."""
        return tuple(name for name in self.draws if name in SIZES)

    def thinned(self, most: int) -> StoredPosterior:
        """So many draws at most, at even distances."""
        if self.size <= most:
            return self
        at = np.linspace(0, self.size - 1, most).round().astype(int)
        draws = {name: values[at] for name, values in self.draws.items()}
        return replace(self, draws=draws)


def read_posterior(file: str | os.PathLike[str]) -> StoredPosterior:
    """The draws of a file ``posterior.nc``.

    Raises
    ------
    ValueError
        If the file cannot be read or has no draws of elastic constants.
    """
    path = Path(file)
    if not path.is_file():
        kind = "a directory" if path.is_dir() else "no file there"
        raise ValueError(
            f"{path}: {kind}, accepted: the posterior.nc that `identify --backend emcee --out DIR` writes"
        )
    return stored_posterior(_opened(path), str(path))


def _opened(path: Path) -> Any:
    try:
        return opened_draws(path)
    except (OSError, ValueError, KeyError, TypeError, RuntimeError) as error:
        said = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise ValueError(
            f"{path}: cannot be read as NetCDF ({said}), accepted: the posterior.nc that "
            "`identify --backend emcee --out DIR` writes"
        ) from None


def stored_posterior(data: Any, source: str) -> StoredPosterior:
    """The draws among the groups of a posterior; source : what they are called in messages.

    Raises
    ------
    ValueError
        If there are no draws of elastic constants, or broken ones.
    """
    group = data["posterior"].dataset if "posterior" in data.children else {}
    draws = {}
    for user in _in_order(str(name) for name in group):
        material, plain = split_name(user)
        name = USER_UNITS[plain][0]
        if name in _KNOWN and group[user].dims == ("chain", "draw"):
            values = to_si(plain, 1.0) * np.asarray(group[user], dtype=float).ravel()
            draws[joined_name(material, name)] = values
    if not any(split_name(name)[1] in CONSTANTS for name in draws):
        raise ValueError(
            f"{source}: no draws of elastic constants, accepted: the posterior.nc that "
            "`identify --backend emcee --out DIR` writes"
        )
    broken = [name for name, values in draws.items() if len(values) < 2 or not np.all(np.isfinite(values))]
    if broken:
        raise ValueError(f"{source}: draws of {', '.join(broken)} are too few or not finite numbers")
    attrs = data.attrs
    given = attrs.get("repeatability")
    return StoredPosterior(
        source=source,
        draws=draws,
        plate=str(attrs.get("plate", "")),
        specimen=str(attrs.get("specimen", "")),
        symmetry=str(attrs.get("symmetry", "")),
        held=_held(attrs),
        repeatability=None if given is None else float(given),
        outline=_outline(data),
    )


def _outline(data: Any) -> dict[str, float]:
    group = data["constant_data"].dataset if "constant_data" in data.children else {}
    names = {user_name(name): name for name in ("length", "width", "thickness")}
    return {
        name: to_si(user, float(np.ravel(group[user])[0])) for user, name in names.items() if user in group
    }


def _held(attrs: Mapping[str, Any]) -> dict[str, float]:
    given = json.loads(attrs.get("held_constants", "{}"))
    held = {}
    for user in _in_order(given):
        material, plain = split_name(user)
        held[joined_name(material, USER_UNITS[plain][0])] = to_si(plain, float(given[user]))
    return held


def _in_order(names: Iterable[str]) -> list[str]:
    """The names of a plate file among some, those of each material in the file's order."""
    order = list(USER_UNITS)
    known = (name for name in names if split_name(name)[1] in order)
    return sorted(known, key=lambda name: order.index(split_name(name)[1]))
