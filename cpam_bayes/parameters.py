"""Parameters with names, units and priors, and the one place where names become vectors."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cpam_bayes.priors import (
    LogUniform,
    Mixture,
    Prior,
    Priors,
    ScaledStudentT,
    TruncatedLogNormal,
    TruncatedNormal,
    Uniform,
)

__all__ = [
    "Coupled",
    "LogUniform",
    "Mixture",
    "Parameter",
    "ParameterSet",
    "Prior",
    "ScaledStudentT",
    "TruncatedLogNormal",
    "TruncatedNormal",
    "Uniform",
    "read_only",
]


@dataclass(frozen=True, slots=True)
class Coupled:
    """A parameter's place in a group whose priors are correlated.

    group : the file that states their correlations
    correlation : of their normal scores, a row for each
    row : of the parameter
    """

    group: str
    correlation: tuple[tuple[float, ...], ...]
    row: int


@dataclass(frozen=True, slots=True)
class Parameter:
    """One quantity that may vary.

    name : unique within a set
    unit : SI, "" when dimensionless
    prior : in that unit
    null : the value that gives back the plain model, for the parameters of an effect
    shown : display unit and the factor from `unit`, None for `unit` itself
    kind : "scatter" for the relative deviation of a plate's constant from that of its material
    base : its name where there is only one plate, or the constant that it scatters about
    of : the plate, material or list that it belongs to, "" where there is only one
    coupled : its group of correlated priors, None where it is independent
    """

    name: str
    unit: str
    prior: Prior
    null: float | None = None
    shown: tuple[str, float] | None = None
    kind: Literal["quantity", "scatter"] = "quantity"
    base: str = ""
    of: str = ""
    coupled: Coupled | None = None

    @property
    def own(self) -> str:
        """Its name without the plate, material or list that it belongs to."""
        return self.base or self.name

    @property
    def display(self) -> tuple[str, float]:
        """The unit that it is shown in, and the factor from SI."""
        return self.shown or (self.unit, 1.0)


@dataclass(frozen=True, slots=True)
class ParameterSet:
    """Parameters in the order of a vector's entries.

    parameters : the ones that vary, `size` of them
    fixed : (name, value) of the ones held fixed; `mapping` includes them
    root : (size, size) lower triangular L, L L^T the correlation of the priors' normal scores, a Gaussian
        copula; None where all are independent
    raises ValueError when a name occurs twice
    """

    parameters: tuple[Parameter, ...]
    fixed: tuple[tuple[str, float], ...] = ()
    root: NDArray[np.float64] | None = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        names = [*self.names, *(name for name, _ in self.fixed)]
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise ValueError(f"names of parameters: received {twice} more than once")
        object.__setattr__(self, "root", _root(self.parameters))

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the varying parameters, in the order of a vector."""
        return tuple(parameter.name for parameter in self.parameters)

    @property
    def size(self) -> int:
        """Length of a vector."""
        return len(self.parameters)

    @property
    def lower(self) -> NDArray[np.float64]:
        """Lower bounds, (size,), each in its unit."""
        return read_only([parameter.prior.lower for parameter in self.parameters])

    @property
    def upper(self) -> NDArray[np.float64]:
        """Upper bounds, (size,), each in its unit."""
        return read_only([parameter.prior.upper for parameter in self.parameters])

    @property
    def prior_sd(self) -> NDArray[np.float64]:
        """Standard deviations of the priors, (n,)."""
        return np.array([p.prior.sd for p in self.parameters])

    def __contains__(self, name: object) -> bool:
        """Whether a parameter of this name varies."""
        return name in self.names

    def __getitem__(self, name: str) -> Parameter:
        """The varying parameter of this name; KeyError lists the names there are."""
        for parameter in self.parameters:
            if parameter.name == name:
                return parameter
        raise KeyError(f"parameter {name!r}: there are {list(self.names)}")

    def union(self, other: ParameterSet) -> ParameterSet:
        """The union of both sets, in order, shared parameters once.

        raises ValueError when a name is defined differently in the two
        """
        mine: dict[str, Parameter | float] = {p.name: p for p in self.parameters}
        mine |= dict(self.fixed)
        theirs: dict[str, Parameter | float] = {p.name: p for p in other.parameters}
        theirs |= dict(other.fixed)
        for name, definition in theirs.items():
            if name in mine and mine[name] != definition:
                raise ValueError(
                    f"parameter {name!r} is defined twice: {mine[name]} and {definition}; "
                    "rename one or make them equal"
                )
        return ParameterSet(
            self.parameters + tuple(p for p in other.parameters if p.name not in mine),
            self.fixed + tuple((name, value) for name, value in other.fixed if name not in mine),
        )

    def fix(self, **values: float) -> ParameterSet:
        """The set with some parameters held at values, in their units.

        raises ValueError for a name that does not vary or a value that is not finite
        """
        self._require(values)
        wrong = {name: value for name, value in values.items() if not np.isfinite(value)}
        if wrong:
            raise ValueError(f"fixed values: received {wrong}, accepted: finite numbers")
        rest = self.without(*values)
        return ParameterSet(
            rest.parameters,
            self.fixed + tuple((name, float(value)) for name, value in values.items()),
        )

    def without(self, *names: str) -> ParameterSet:
        """The set without some of its varying parameters.

        raises ValueError for a name that does not vary
        """
        self._require(names)
        return ParameterSet(tuple(p for p in self.parameters if p.name not in names), self.fixed)

    def mapping(self, x: ArrayLike) -> dict[str, NDArray[Any]]:
        """Vectors to names: (..., size) -> {name: (...)}, fixed ones included; real or complex.

        raises ValueError when the last axis is not `size` long
        """
        x = self._vectors(x)
        named = {name: x[..., i] for i, name in enumerate(self.names)}
        fixed = {name: np.full(x.shape[:-1], value) for name, value in self.fixed}
        return named | fixed

    def vector(self, mapping: Mapping[str, ArrayLike]) -> NDArray[Any]:
        """Names to vectors: {name: (...)} -> (..., size); names beyond the set are ignored.

        raises ValueError for a missing name
        """
        missing = [name for name in self.names if name not in mapping]
        if missing:
            raise ValueError(f"parameters {missing} have no value; received {sorted(mapping)}")
        if not self.parameters:
            return np.empty(0)
        columns = np.broadcast_arrays(*(np.asarray(mapping[name]) for name in self.names))
        return np.stack(columns, axis=-1)

    @property
    def precision(self) -> NDArray[np.float64]:
        """Inverse of the correlation of the priors' normal scores, (size, size)."""
        return np.eye(self.size) if self.root is None else read_only(np.linalg.inv(self.root @ self.root.T))

    def log_prior(self, x: ArrayLike) -> NDArray[np.float64]:
        """Log density of the priors, (..., size) -> (...), -inf outside any bound.

        raises ValueError when the last axis is not `size` long
        """
        x = self._vectors(x)
        total = np.zeros(x.shape[:-1])
        for i, parameter in enumerate(self.parameters):
            total = total + parameter.prior.log_density(x[..., i])
        if self.root is not None:
            scores = np.clip(self._priors.to_normal(x), -self._priors.reach, self._priors.reach)
            free = scores @ np.linalg.inv(self.root).T
            total = total + 0.5 * np.sum(scores**2 - free**2, axis=-1)
            total = total - np.log(np.diag(self.root)).sum()
        return np.asarray(total)

    def sample(self, rng: np.random.Generator, size: int) -> NDArray[np.float64]:
        """Independent draws from the priors, (size, self.size)."""
        draws = np.empty((size, self.size))
        for i, parameter in enumerate(self.parameters):
            draws[:, i] = parameter.prior.sample(rng, size)
        if self.root is not None:
            moved = self._priors.from_normal(self._priors.to_normal(draws) @ self.root.T)
            for i, parameter in enumerate(self.parameters):
                if parameter.coupled is not None:
                    draws[:, i] = moved[:, i]
        return draws

    @property
    def _priors(self) -> Priors:
        return Priors(tuple(p.prior for p in self.parameters))

    def _require(self, names: Mapping[str, float] | tuple[str, ...]) -> None:
        unknown = [name for name in names if name not in self]
        if unknown:
            raise ValueError(f"parameters {unknown} do not vary; there are {list(self.names)}")

    def _vectors(self, x: ArrayLike) -> NDArray[Any]:
        array = np.asarray(x)
        if array.ndim == 0 or array.shape[-1] != self.size:
            raise ValueError(
                f"parameter vector: received shape {array.shape}, "
                f"accepted: (..., {self.size}) for {list(self.names)}"
            )
        return array


def _root(parameters: tuple[Parameter, ...]) -> NDArray[np.float64] | None:
    """`ParameterSet.root`; missing members of a group are integrated out."""
    groups: dict[Any, list[int]] = {}
    for i, parameter in enumerate(parameters):
        if parameter.coupled is not None:
            key = (parameter.coupled.group, parameter.coupled.correlation, parameter.of)
            groups.setdefault(key, []).append(i)
    if not groups:
        return None
    root = np.eye(len(parameters))
    for (_, correlation, _), columns in groups.items():
        rows = [c.row for c in (parameters[i].coupled for i in columns) if c is not None]
        root[np.ix_(columns, columns)] = np.linalg.cholesky(np.array(correlation)[np.ix_(rows, rows)])
    return read_only(root)


def read_only(values: ArrayLike) -> NDArray[np.float64]:
    """A read-only copy as an array of floats."""
    array = np.array(values, dtype=float)
    array.flags.writeable = False
    return array
