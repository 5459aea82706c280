"""Relations between the elastic constants of one ply: eq. (6), (9) and (11) of the paper, and without them.

The symmetry of a ply says which constants it has and what they must satisfy:

* isotropic: E1 and nu12 are all constants, eq. (11), and -1 < nu12 < 1/2;
* transversely isotropic about the fibres, as the paper's composites: G23 follows from eq. (6), and the
  constants satisfy eq. (9);
* orthotropic, as fabrics, wood and plywood: all are free, and the stiffness in plane stress is positive
  definite (Jones, Mechanics of Composite Materials, section 2.4).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final, Literal, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.inexact[Any]]

MaterialSymmetry: TypeAlias = Literal["isotropic", "transversely_isotropic", "orthotropic"]

CONSTANTS = ("E1", "E2", "nu12", "G12", "G13", "G23")
ISOTROPIC_CONSTANTS = ("E1", "nu12")
_MODULI = ("E1", "E2", "G12", "G13", "G23")

CONSTRAINTS: Final[Mapping[MaterialSymmetry, tuple[str, ...]]] = {
    "isotropic": ("-1 < nu12 < 0.5",),
    "transversely_isotropic": (
        "nu12 < 0.5, a positive definite stiffness, first of eq. (9)",
        "|nu12 (1 - nu12 E2/E1) / (1 - nu12)| < 1, second of eq. (9)",
        "|nu12| < sqrt(E1/E2), third of eq. (9)",
        "E1 > E2, fourth of eq. (9)",
    ),
    "orthotropic": ("|nu12| < sqrt(E1/E2), a positive definite stiffness",),
}
"""What the constants of a ply must satisfy, in the order of `constraint_margins`."""


def through_thickness_poisson(
    E1: Array | float,
    E2: Array | float,
    nu12: Array | float,
) -> Array:
    """Poisson's ratio nu23 of a transversely isotropic ply, the second part of eq. (6).

    E1, E2 : (...) Pa.
    nu12 : (...); returns (...). Complex arrays pass through.
    """
    return np.asarray(nu12 * (1.0 - nu12 * E2 / E1) / (1.0 - nu12))


def complete_constants(constants: Mapping[str, ArrayLike], symmetry: MaterialSymmetry) -> dict[str, Array]:
    """Fill in the constants that follow from the others, eq. (6) and (11).

    constants : E1, E2, nu12, G12 and optionally G13, G23, or E1 and nu12 alone when isotropic;
        each (...), Pa or dimensionless, real or complex
    returns E1 E2 nu12 G12 G13 G23: where they are left out, G13 = G12, and G23 by eq. (6) or, of an
        orthotropic ply, G23 = G12; isotropic: E2 = E1 and each shear modulus E1 / (2 (1 + nu12))
    raises ValueError for a missing or an unknown constant
    """
    _require_names(constants, symmetry)
    given = {name: _inexact(value) for name, value in constants.items()}
    if symmetry == "isotropic":
        E, nu = given["E1"], given["nu12"]
        G = np.asarray(E / (2.0 * (1.0 + nu)))
        return {"E1": E, "E2": E, "nu12": nu, "G12": G, "G13": G, "G23": G}
    E1, E2, nu12, G12 = (given[name] for name in ("E1", "E2", "nu12", "G12"))
    G23 = given.get("G23")
    if G23 is None and symmetry == "orthotropic":
        G23 = G12
    elif G23 is None:
        G23 = np.asarray(E2 / (2.0 * (1.0 + through_thickness_poisson(E1, E2, nu12))))
    return {
        "E1": E1,
        "E2": E2,
        "nu12": nu12,
        "G12": G12,
        "G13": given.get("G13", G12),
        "G23": G23,
    }


def constraint_margins(constants: Mapping[str, ArrayLike], symmetry: MaterialSymmetry) -> NDArray[np.float64]:
    """By how much a set of constants meets each of its `CONSTRAINTS`, positive where it does.

    Transversely isotropic, eq. (9): the determinant of the stiffness, 1 - |nu23|, sqrt(E1 / E2) - |nu12| and
    E1 / E2 - 1. The first is zero at nu12 = 1/2, whatever E1 and E2 are.

    constants : real, as for `complete_constants`, broadcast to a common shape (...)
    returns (..., n_constraints), NaN where a constant is
    raises ValueError for a missing or an unknown constant
    """
    full = complete_constants(constants, symmetry)
    E1, E2, nu12 = np.broadcast_arrays(*(np.real(full[name]) for name in ("E1", "E2", "nu12")))
    if symmetry == "isotropic":
        return np.asarray(np.minimum(0.5 - nu12, 1.0 + nu12)[..., None])
    with np.errstate(all="ignore"):
        in_plane = np.sqrt(E1 / E2) - np.abs(nu12)
        if symmetry == "orthotropic":
            return np.asarray(in_plane[..., None])
        ratio = E2 / E1
        nu23 = through_thickness_poisson(E1, E2, nu12).real
        determinant = (1.0 - nu23**2) * (1.0 - nu12**2 * ratio) - (
            nu12 * ratio * np.sqrt(E1 / E2) + nu12 * nu23 * np.sqrt(ratio)
        ) ** 2
        return np.stack((determinant, 1.0 - np.abs(nu23), in_plane, E1 / E2 - 1.0), axis=-1)


def constraint_violations(
    constants: Mapping[str, ArrayLike], symmetry: MaterialSymmetry
) -> NDArray[np.bool_]:
    """Which of its `CONSTRAINTS` a set of constants breaks; NaN breaks all that it enters.

    constants : as for `constraint_margins`, (...); returns (..., n_constraints)
    raises ValueError for a missing or an unknown constant
    """
    return np.asarray(~(constraint_margins(constants, symmetry) > 0.0))


def is_admissible(constants: Mapping[str, ArrayLike], symmetry: MaterialSymmetry) -> NDArray[np.bool_]:
    """Whether constants meet all their `CONSTRAINTS` and every modulus is positive.

    constants : as for `constraint_margins`, (...); returns (...)
    raises ValueError for a missing or an unknown constant
    """
    full = complete_constants(constants, symmetry)
    allowed = ~constraint_violations(constants, symmetry).any(axis=-1)
    for name in _MODULI:
        allowed = allowed & (np.real(full[name]) > 0.0)
    return np.asarray(allowed)


def _inexact(value: ArrayLike) -> Array:
    array = np.asarray(value)
    return array if np.issubdtype(array.dtype, np.inexact) else array.astype(np.float64)


def _require_names(constants: Mapping[str, ArrayLike], symmetry: MaterialSymmetry) -> None:
    isotropic = symmetry == "isotropic"
    accepted = ISOTROPIC_CONSTANTS if isotropic else CONSTANTS
    required = ISOTROPIC_CONSTANTS if isotropic else CONSTANTS[:4]
    missing = [name for name in required if name not in constants]
    unknown = [name for name in constants if name not in accepted]
    if missing or unknown:
        raise ValueError(
            f"elastic constants of a ply, {symmetry.replace('_', ' ')}: received {sorted(constants)}, "
            f"required {list(required)}, accepted {list(accepted)}"
        )
