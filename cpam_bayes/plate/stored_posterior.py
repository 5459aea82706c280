"""A posterior stored by `identify --out DIR`: its draws in SI, and the prior made from them.

`[material] posterior` of a plate file names one, of a former plate of the material. The prior is that
posterior within the bounds of [unknowns], a Gaussian copula: moduli are log-normal, being positive and
scaled by errors of thickness and density; Poisson's ratio, which may be about zero, is normal.
"""

from __future__ import annotations

import json
import math
import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from cpam_bayes.parameters import Coupled, Prior, TruncatedLogNormal, TruncatedNormal
from cpam_bayes.plate.checks import CONSTANT_KEYS, symmetry_of
from cpam_bayes.plate.laminate import CONSTANTS
from cpam_bayes.plate.records import (
    USER_UNITS,
    USUAL_SD,
    joined_name,
    split_name,
    to_si,
    to_user,
    user_name,
)
from cpam_bayes.plate.schema import is_hybrid
from cpam_bayes.plate.text import Data, Problem, numbers, table
from cpam_bayes.storage import opened_draws

Array = NDArray[Any]


@dataclass(frozen=True, slots=True)
class StoredPosterior:
    """Draws of the constants of a plate.

    source : the file, or the name of the plate
    draws : name -> (n_draws,) SI; the constants, sizes and noise that varied
    plate, specimen : names of the plate that was measured
    symmetry : of its material, "" where the file does not say
    held : constants held at the values of the plate file, SI
    repeatability : relative standard deviation of a measured frequency where it was given, else None
    outline : length, width and thickness in the plate file, m, as far as they are given
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
        return tuple(name for name in self.draws if name in USUAL_SD)

    def thinned(self, most: int) -> StoredPosterior:
        """The posterior with at most this many draws, evenly spaced."""
        if self.size <= most:
            return self
        at = np.linspace(0, self.size - 1, most).round().astype(int)
        draws = {name: values[at] for name, values in self.draws.items()}
        return replace(self, draws=draws)


def read_posterior(file: str | os.PathLike[str]) -> StoredPosterior:
    """The draws of a file ``posterior.nc``.

    raises ValueError if the file cannot be read or has no draws of elastic constants
    """
    path = Path(file)
    if not path.is_file():
        kind = "a directory" if path.is_dir() else "no file there"
        raise ValueError(f"{path}: {kind}, accepted: the posterior.nc that `identify --out DIR` writes")
    return stored_posterior(_opened(path), str(path))


def _opened(path: Path) -> Any:
    try:
        return opened_draws(path)
    except (OSError, ValueError, KeyError, TypeError, RuntimeError):
        raise ValueError(
            f"{path}: cannot be read as NetCDF, accepted: the posterior.nc that `identify --out DIR` writes"
        ) from None


def stored_posterior(data: Any, source: str) -> StoredPosterior:
    """The draws in the groups of a posterior; source : its name in messages.

    raises ValueError if there are no draws of elastic constants, or broken ones
    """
    group = data["posterior"].dataset if "posterior" in data.children else {}
    draws = {}
    for user in _in_order(str(name) for name in group):
        material, plain = split_name(user)
        name = USER_UNITS[plain][0]
        if group[user].dims == ("chain", "draw"):
            values = to_si(plain, 1.0) * np.asarray(group[user], dtype=float).ravel()
            draws[joined_name(material, name)] = values
    if not any(split_name(name)[1] in CONSTANTS for name in draws):
        raise ValueError(
            f"{source}: no draws of elastic constants, accepted: the posterior.nc that "
            "`identify --out DIR` writes"
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
    """Those of the names that a plate file has, for each material in the file's order."""
    order = list(USER_UNITS)
    known = (name for name in names if split_name(name)[1] in order)
    return sorted(known, key=lambda name: order.index(split_name(name)[1]))


FormerPriors = Mapping[str, tuple[Prior, Coupled]]
"""Prior and place among the coupled ones, for each unknown of a former posterior by its name in the file."""

# Least number of draws within the bounds that correlations are taken from.
_FEWEST = 100
# A bound this many standard deviations away cuts nothing.
_FAR = 5.0
# Largest scale of the normal density, in ranges of its bounds, and distance of its centre from the mean, in
# scales: beyond them it is flat or exponential in any case.
_WIDEST, _OUTERMOST = 3.0, 25.0
# Scores are clipped here; the ridge regularises the correlation of scores that coincide.
_MAX_SCORE, _RIDGE = 7.0, 1e-9


def with_former_posteriors(
    data: Data, directory: Path | None
) -> tuple[dict[str, Any], dict[str, FormerPriors], list[Problem]]:
    """A plate file completed with reference constants from former posteriors, their priors, and problems.

    The priors are by the name of the material, "" where there is only one.

    directory : base of relative paths
    """
    data, priors, problems = dict(data), dict[str, FormerPriors](), list[Problem]()
    material, unknowns = table(data, "material"), table(data, "unknowns")
    if not is_hybrid(material):
        data["material"], priors[""], problems = _of_material("", material, unknowns, directory)
        return data, priors, problems
    filled = dict(material)
    for name in material:
        part, of_part = table(data, "material", name), table(data, "unknowns", name)
        filled[name], priors[name], found = _of_material(name, part, of_part, directory)
        problems += [problem.of_material(name) for problem in found]
    return {**data, "material": filled}, priors, problems


def _of_material(
    name: str, material: Data, unknowns: Data, directory: Path | None
) -> tuple[Data, FormerPriors, list[Problem]]:
    """A table [material] with its gaps filled, the priors of its [unknowns], and their problems."""
    key, file = ("material", "posterior"), material.get("posterior")
    if not isinstance(file, str) or not file:
        return material, {}, []
    try:
        stored = read_posterior((directory or Path()) / file)
    except ValueError as error:
        return material, {}, [Problem(key, str(error))]
    draws = {user_name(n): to_user(n, 1.0) * stored.draws[n] for n in stored.constants}
    # of a material of several, or of the only one of a former plate
    split = {split_name(key): x for key, x in draws.items()}
    own = {key: x for (of, key), x in split.items() if of == name}
    draws = own or {key: x for (of, key), x in split.items() if not of}
    means = {key: float(np.mean(x)) for key, x in draws.items() if key not in material}
    left_out = stored.symmetry and symmetry_of(material) is None
    filled = {**material, **means, **({"symmetry": stored.symmetry} if left_out else {})}
    symmetry = symmetry_of(filled)
    if stored.symmetry and stored.symmetry != symmetry:
        said = f"of a material that is {stored.symmetry}, accepted: the symmetry of [material], {symmetry}"
        return material, {}, [Problem(key, said)]
    asked = [key for key in CONSTANT_KEYS if key in unknowns]
    known = [key for key in asked if key in draws]
    if not asked:
        return filled, {}, []
    if not known:
        said = f"knows {' '.join(draws) or 'no constant of one material'}, accepted: one of the [unknowns], "
        return filled, {}, [Problem(key, f"{said}{' '.join(asked)}")]
    twice = [
        Problem(path, f"beside material.posterior, which is a prior of {k} too, accepted: one of the two")
        for k in known
        for path, given in (
            (("material", "sd", k), k in table(material, "sd")),
            (("unknowns", k), isinstance(unknowns[k], dict)),
        )
        if given
    ]
    if twice:
        return filled, {}, twice
    bounds = {k: b for k in known if (b := numbers(unknowns, k)) and len(b) == 2 and b[0] < b[1]}
    if len(bounds) < len(known):  # said by the checks of bounds
        return filled, {}, []
    try:
        return filled, _priors(stored.source, {k: draws[k] for k in known}, bounds), []
    except ValueError as error:
        return filled, {}, [Problem(key, str(error))]


def _priors(source: str, draws: Mapping[str, Array], bounds: Mapping[str, list[float]]) -> FormerPriors:
    """Priors in SI from the draws within the bounds, both in the units of the plate file.

    Raises ``ValueError`` where the bounds leave too few draws, or a constant does not vary.
    """
    every = np.column_stack(list(draws.values()))
    lower, upper = np.array([bounds[key] for key in draws]).T
    inside = every[np.all((every >= lower) & (every <= upper), axis=1)]
    if len(inside) < _FEWEST:
        raise ValueError(
            f"{len(inside)} of its {len(every)} draws are within the bounds of [unknowns], accepted: "
            f"{_FEWEST} or more; widen the bounds"
        )
    still = [key for key, x in zip(draws, inside.T, strict=True) if np.ptp(x) == 0.0]
    if still:
        raise ValueError(f"draws of {' '.join(still)} that are all equal, accepted: draws of a posterior")
    priors = [
        _matched(key, to_si(key, 1.0) * x, *(to_si(key, b) for b in bounds[key]))
        for key, x in zip(draws, inside.T, strict=True)
    ]
    each = zip(priors, draws, inside.T, strict=True)
    scores = np.array([prior.to_normal(to_si(key, 1.0) * x) for prior, key, x in each])
    covariance = np.atleast_2d(np.corrcoef(np.clip(scores, -_MAX_SCORE, _MAX_SCORE)))
    covariance = (covariance + _RIDGE * np.eye(len(priors))) / (1.0 + _RIDGE)
    correlation = tuple(map(tuple, covariance.tolist()))
    of = zip(draws, priors, strict=True)
    return {key: (prior, Coupled(source, correlation, row)) for row, (key, prior) in enumerate(of)}


def _matched(key: str, draws: Array, lower: float, upper: float) -> Prior:
    """The density whose mean and sd between the bounds, of ln x for a modulus, match those of the draws."""
    logged = key != "nu12"
    x = np.log(draws) if logged else draws
    low, high = (math.log(lower), math.log(upper)) if logged else (lower, upper)
    mean, sd = float(x.mean()), float(x.std())
    loc, scale = mean, sd
    if min(mean - low, high - mean) < _FAR * sd:
        # a density that a bound cuts was wider, or centred elsewhere
        def missed(at: Array) -> Array:
            width = float(np.exp(at[1]))
            cut = TruncatedNormal(mean + at[0] * width, width, low, high)
            return np.array([(cut.mean - mean) / sd, math.log(cut.sd / sd)])

        widest = math.log(_WIDEST * (high - low))
        ends = ([-_OUTERMOST, math.log(0.5 * sd)], [_OUTERMOST, widest])
        found = least_squares(missed, (0.0, min(math.log(sd), widest - 0.1)), bounds=ends).x
        scale = float(np.exp(found[1]))
        loc = mean + float(found[0]) * scale
    if logged:
        return TruncatedLogNormal(math.exp(loc), scale, lower, upper)
    return TruncatedNormal(loc, scale, lower, upper)
