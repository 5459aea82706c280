"""Relations between the elastic constants of one ply, eq. (6), (9) and (11) of the paper."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.inexact[Any]]

CONSTANTS = ("E1", "E2", "nu12", "G12", "G13", "G23")
ISOTROPIC_CONSTANTS = ("E1", "nu12")
_MODULI = ("E1", "E2", "G12", "G13", "G23")


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


def complete_constants(constants: Mapping[str, ArrayLike], isotropic: bool) -> dict[str, Array]:
    """Fill in the constants that follow from the others, eq. (6) and (11).

    constants : E1, E2, nu12, G12 and optionally G13, G23, or E1 and nu12 alone when isotropic;
        each (...), Pa or dimensionless, real or complex
    returns E1 E2 nu12 G12 G13 G23: G13 = G12 and G23 by eq. (6) where they are left out;
        isotropic: E2 = E1 and each shear modulus E1 / (2 (1 + nu12))
    raises ValueError for a missing or an unknown constant
    """
    _require_names(constants, isotropic)
    given = {name: _inexact(value) for name, value in constants.items()}
    if isotropic:
        E, nu = given["E1"], given["nu12"]
        G = np.asarray(E / (2.0 * (1.0 + nu)))
        return {"E1": E, "E2": E, "nu12": nu, "G12": G, "G13": G, "G23": G}
    E1, E2, nu12, G12 = (given[name] for name in ("E1", "E2", "nu12", "G12"))
    G23 = given.get("G23")
    if G23 is None:
        G23 = np.asarray(E2 / (2.0 * (1.0 + through_thickness_poisson(E1, E2, nu12))))
    return {
        "E1": E1,
        "E2": E2,
        "nu12": nu12,
        "G12": G12,
        "G13": given.get("G13", G12),
        "G23": G23,
    }


def constraint_violations(constants: Mapping[str, ArrayLike], isotropic: bool) -> NDArray[np.bool_]:
    """Which of the four constraints of eq. (9) a set of constants breaks.

    constants : real, as for `complete_constants`, broadcast to a common shape (...)
    returns (..., 4): positive determinant, |nu23| < 1, |nu12| < sqrt(E1 / E2), E1 / E2 > 1. The
        last is no constraint on an isotropic plate and is False there. NaN breaks a constraint.
    raises ValueError for a missing or an unknown constant
    """
    full = complete_constants(constants, isotropic)
    E1, E2, nu12 = np.broadcast_arrays(*(np.real(full[name]) for name in ("E1", "E2", "nu12")))
    with np.errstate(all="ignore"):
        ratio = E2 / E1
        nu23 = through_thickness_poisson(E1, E2, nu12).real
        determinant = (1.0 - nu23**2) * (1.0 - nu12**2 * ratio) - (
            nu12 * ratio * np.sqrt(E1 / E2) + nu12 * nu23 * np.sqrt(ratio)
        ) ** 2
        holds = (
            determinant > 0.0,
            np.abs(nu23) < 1.0,
            np.abs(nu12) < np.sqrt(E1 / E2),
            np.ones(np.shape(E1), dtype=bool) if isotropic else E1 / E2 > 1.0,
        )
    return np.asarray(~np.stack(holds, axis=-1), dtype=bool)


def is_admissible(constants: Mapping[str, ArrayLike], isotropic: bool) -> NDArray[np.bool_]:
    """Whether constants meet every constraint of eq. (9) and every modulus is positive.

    constants : as for `constraint_violations`, (...); returns (...)
    raises ValueError for a missing or an unknown constant
    """
    full = complete_constants(constants, isotropic)
    allowed = ~constraint_violations(constants, isotropic).any(axis=-1)
    for name in _MODULI:
        allowed = allowed & (np.real(full[name]) > 0.0)
    return np.asarray(allowed)


def _inexact(value: ArrayLike) -> Array:
    array = np.asarray(value)
    return array if np.issubdtype(array.dtype, np.inexact) else array.astype(np.float64)


def _require_names(constants: Mapping[str, ArrayLike], isotropic: bool) -> None:
    accepted = ISOTROPIC_CONSTANTS if isotropic else CONSTANTS
    required = ISOTROPIC_CONSTANTS if isotropic else CONSTANTS[:4]
    missing = [name for name in required if name not in constants]
    unknown = [name for name in constants if name not in accepted]
    if missing or unknown:
        kind = "an isotropic" if isotropic else "an orthotropic"
        raise ValueError(
            f"elastic constants of {kind} ply: received {sorted(constants)}, "
            f"required {list(required)}, accepted {list(accepted)}"
        )
