"""The plate as an eigenvalue problem: bilinear forms, each with a coefficient that depends on the parameters.

A plate occupies the reference square: xi = x / length, eta = y / width, both in [0, 1]. Forms
live on the reference square and never change; sizes, thickness, density, constants and angles
enter through coefficients alone. An effect is a function ``Problem -> Problem``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from itertools import combinations_with_replacement
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.parameters import Parameter, ParameterSet, Uniform
from cpam_bayes.plate.edges import EDGES, FIELDS, Field, conditions, is_stated
from cpam_bayes.plate.laminate import (
    ENERGY_CONSISTENT,
    N_STRAINS,
    LaminateGeometry,
    PlyStack,
    ShearModel,
    first_order_stiffness,
    laminate_geometry,
    laminate_stiffness,
)

Array = NDArray[Any]
Derivative = Literal["", "x", "y"]
MatrixKind = Literal["stiffness", "mass"]

MEMBRANE_FIELDS: tuple[Field, ...] = ("u", "v")


@dataclass(frozen=True, slots=True)
class Region:
    """The region of a form: the area, an edge of it, or a point, in reference coordinates.

    span : the part of an edge. "projection" is the area too, but for products of integrals instead
    of an integral of products.
    """

    kind: Literal["area", "edge", "point", "projection"] = "area"
    edge: str = ""
    point: tuple[float, float] = (0.0, 0.0)
    span: tuple[float, float] = (0.0, 1.0)


AREA = Region()


@dataclass(frozen=True, slots=True)
class Atom:
    """A field or its first derivative with respect to a reference coordinate."""

    field: Field
    derivative: Derivative = ""


@dataclass(frozen=True, slots=True)
class Form:
    """Symmetric bilinear form: the integral of left(a) right(b), and of right(a) left(b) if they differ.

    ``weight`` maps reference points (n, 2) to values (n,); ``None`` is one. On a "projection" it
    maps them to (n, r), functions g_k, and the form is the sum over k of the integral of g_k left(a)
    times that of g_k right(b).
    """

    left: Atom
    right: Atom
    region: Region = AREA
    weight: Callable[[Array], Array] | None = None


# Generalised strains as sums of atoms; the pair is (atom, which size divides it).
STRAIN_ATOMS: tuple[tuple[tuple[Atom, str], ...], ...] = (
    ((Atom("u", "x"), "length"),),
    ((Atom("v", "y"), "width"),),
    ((Atom("u", "y"), "width"), (Atom("v", "x"), "length")),
    ((Atom("phi_x", "x"), "length"),),
    ((Atom("phi_y", "y"), "width"),),
    ((Atom("phi_x", "y"), "width"), (Atom("phi_y", "x"), "length")),
    ((Atom("w", "y"), "width"), (Atom("phi_y"), "")),
    ((Atom("w", "x"), "length"), (Atom("phi_x"), "")),
)


def _strain_energy() -> tuple[tuple[Form, ...], NDArray[np.intp], NDArray[np.intp]]:
    """Forms of the strain energy with, for each, its stiffness entry and the powers of 1/length, 1/width."""
    atoms = [(i, atom, size) for i, row in enumerate(STRAIN_ATOMS) for atom, size in row]
    forms, entries, powers = [], [], []
    for (i, a, size_a), (j, b, size_b) in combinations_with_replacement(atoms, 2):
        if (i < 6) != (j < 6):  # transverse shear does not couple with the other strains
            continue
        forms.append(Form(a, b))
        entries.append((i, j))
        powers.append([(size_a, size_b).count(size) for size in ("length", "width")])
    return tuple(forms), np.array(entries).T, np.array(powers).T


# The laminate stiffness entry of each form, (2, n_forms), and its powers of 1/length, 1/width.
LAMINATE_FORMS, LAMINATE_ENTRIES, _POWER = _strain_energy()
# The same entry in a flat 8 x 8 matrix, and the index of its product of sides in `_side_products`.
_FLAT_ENTRIES = np.ravel_multi_index(tuple(LAMINATE_ENTRIES), (N_STRAINS, N_STRAINS))
_SIDES = np.array([[0, 2, 5], [1, 3, -1], [4, -1, -1]])[tuple(_POWER)]
MASS_FORMS = tuple(Form(Atom(f), Atom(f)) for f in FIELDS)
_ATOMS = tuple(dict.fromkeys(atom for row in STRAIN_ATOMS for atom, _ in row))
_LEFT = np.array([_ATOMS.index(f.left) for f in LAMINATE_FORMS])
_RIGHT = np.array([_ATOMS.index(f.right) for f in LAMINATE_FORMS])
# Powers of h in the coefficients of LAMINATE_FORMS: 1 (A, A_s), 2 (B), 3 (D).
THICKNESS_POWERS = 1 + np.sum((LAMINATE_ENTRIES >= 3) & (LAMINATE_ENTRIES < 6), axis=0)


@dataclass(frozen=True, slots=True)
class PlateState:
    """Numbers of a plate, SI, each broadcastable over parameter sets (...).

    ``layup`` is (n_plies,) or (..., n_plies) degrees, or a precomputed ``LaminateGeometry``.
    ``changes`` are applied to the laminate's stiffness (..., 8, 8), first to last. ``skew`` is the
    angle in radians by which the edges x = 0 and x = length lean towards x; sides keep their lengths.
    ``plies`` : thicknesses and materials, ``None`` where all are alike. ``known`` : the stiffness with its
    changes, where it has been computed.
    """

    length: Array
    width: Array
    thickness: Array
    density: Array
    constants: Mapping[str, Array]
    layup: Array | LaminateGeometry
    shear: ShearModel = ENERGY_CONSISTENT
    symmetric: bool | None = None
    changes: tuple[Callable[[Array], Array], ...] = ()
    skew: Array | None = None
    plies: PlyStack | None = None
    known: Array | None = None

    def geometry(self) -> LaminateGeometry:
        """The part of the layup that does not depend on the constants."""
        if isinstance(self.layup, LaminateGeometry):
            return self.layup
        return laminate_geometry(self.layup, symmetric=self.symmetric, plies=self.plies)

    def stiffness(self) -> Array:
        """The 8 x 8 laminate stiffness, (..., 8, 8)."""
        if self.known is not None:
            return self.known
        return self._changed(laminate_stiffness(*self._laminate))

    def computed(self, *, steps: bool = False) -> PlateState:
        """The state with its stiffness computed, which several terms need.

        steps : whether the last axis is of complex steps with a common real part
        """
        stiffness = (first_order_stiffness if steps else laminate_stiffness)(*self._laminate)
        return replace(self, known=self._changed(stiffness))

    @property
    def _laminate(self) -> tuple[Mapping[str, Array], LaminateGeometry, Array, ShearModel]:
        return self.constants, self.geometry(), self.thickness, self.shear

    def _changed(self, stiffness: Array) -> Array:
        for change in self.changes:
            stiffness = change(stiffness)
        return stiffness

    @property
    def area(self) -> Array:
        """Area of the plate, m2."""
        area = self.length * self.width
        return np.asarray(area if self.skew is None else area * np.cos(self.skew))


Values = Mapping[str, Array]
StateFunction = Callable[[Values], PlateState]
Admissible = Callable[[Values], NDArray[np.bool_]]
CoefficientFunction = Callable[[PlateState, Values], Array]


@dataclass(frozen=True, slots=True)
class Term:
    """Forms that enter K or M with coefficients (..., n_forms) computed from the plate's state."""

    name: str
    matrix: MatrixKind
    forms: tuple[Form, ...]
    coefficients: CoefficientFunction


@dataclass(frozen=True, slots=True)
class Bias:
    """The correction of a frequency f of the theory for three dimensions, f exp(slope f).

    slope : 1/Hz
    """

    slope: float = 0.0

    def of(self, f: Array) -> Array:
        """Frequencies in three dimensions."""
        return np.asarray(f * np.exp(self.slope * f)) if self else f

    def slopes(self, f: Array) -> Array:
        """Derivatives of ``of`` with respect to f."""
        return np.asarray((1.0 + self.slope * f) * np.exp(self.slope * f))

    def __bool__(self) -> bool:
        return self.slope != 0.0


THEORY_ALONE = Bias()


@dataclass(frozen=True, slots=True)
class Problem:
    """A plate with its unknown parameters, to be discretised.

    ``edges`` are four of F, S, C for x = 0, y = 0, x = length, y = width. ``state`` maps parameter values
    to the plate's numbers, ``nominal`` is the state to which discretisations are tuned. ``admissible`` is
    true where parameter values are physical, (...) bool. ``supported`` plates are on a soft support, so
    that their rigid-body motions have low frequencies instead of zero.

    ``bias`` : of the theory's frequencies, included in all predictions of a model.
    ``rigid_content`` : fields and powers of (xi, eta) in rigid-body motions besides those of the plane
    rectangle.
    """

    parameters: ParameterSet
    edges: str
    nominal: PlateState
    state: StateFunction
    terms: tuple[Term, ...]
    admissible: Admissible
    supported: bool = False
    rigid_content: tuple[tuple[Field, tuple[int, int]], ...] = ()
    bias: Bias = THEORY_ALONE

    def coefficients(self, values: Values, matrix: MatrixKind) -> Array:
        """Coefficients of every form of K or M at the given values, (..., n_forms)."""
        state = self.state(values)
        return self._coefficients(state.computed() if matrix == "stiffness" else state, values, matrix)

    def both_coefficients(self, values: Values, *, steps: bool = False) -> tuple[Array, Array]:
        """Coefficients of K and of M at the given values, (..., n_stiffness) and (..., n_mass).

        steps : whether the last axis of the values is of complex steps from one set of values: the result is
            then of first order in them, and exact
        """
        state = self.state(values).computed(steps=steps)
        return self._coefficients(state, values, "stiffness"), self._coefficients(state, values, "mass")

    def _coefficients(self, state: PlateState, values: Values, matrix: MatrixKind) -> Array:
        parts = [t.coefficients(state, values) for t in self.terms if t.matrix == matrix]
        if len(parts) == 1:
            return parts[0]
        shape = np.broadcast_shapes(*(p.shape[:-1] for p in parts))
        return np.concatenate([np.broadcast_to(p, (*shape, p.shape[-1])) for p in parts], axis=-1)

    def forms(self, matrix: MatrixKind) -> tuple[Form, ...]:
        """Forms of K or M, in the order of ``coefficients``."""
        return tuple(f for t in self.terms if t.matrix == matrix for f in t.forms)

    def with_terms(self, *terms: Term) -> Problem:
        """The problem with further terms."""
        return replace(self, terms=(*self.terms, *terms))


# The parameter that selects one of several problems, counted from 0.
FORM = "form"


def any_of(problems: Sequence[Problem]) -> Problem:
    """A plate in any of several forms that share terms and parameters."""
    first, n = problems[0], len(problems)
    number = ParameterSet((Parameter(FORM, "", Uniform(0.0, n), 0.5 * n),))
    kinds: tuple[MatrixKind, ...] = ("stiffness", "mass")
    terms = (Term(FORM, kind, first.forms(kind), partial(_of_form, problems, kind)) for kind in kinds)
    return replace(first, parameters=first.parameters.union(number), terms=tuple(terms))


def _of_form(problems: Sequence[Problem], kind: MatrixKind, state: PlateState, values: Values) -> Array:
    """Coefficients (m, n_forms) at m sets of values."""
    del state
    number = np.minimum(values[FORM].astype(int), len(problems) - 1)
    found = np.empty((len(number), len(problems[0].forms(kind))))
    for i in np.unique(number):
        rows = number == i
        found[rows] = problems[i].coefficients({name: v[rows] for name, v in values.items()}, kind)
    return found


def laminate_coefficients(state: PlateState, values: Values) -> Array:
    """Coefficients of the strain energy: stiffness entries times powers of the sizes, (..., n_forms)."""
    del values
    if state.skew is not None:
        return _skewed_coefficients(state)
    stiffness = state.stiffness()
    entries = stiffness.reshape(*stiffness.shape[:-2], N_STRAINS**2).take(_FLAT_ENTRIES, axis=-1)
    return np.asarray(entries * _side_products(state.length, state.width).take(_SIDES, axis=-1))


def _side_products(length: Array, width: Array) -> Array:
    """a b, b, a, 1, b/a and a/b of sides a, b (...), (..., 6): the area times powers of 1/a and 1/b."""
    a, b = np.broadcast_arrays(length, width)
    return np.stack((a * b, b, a, np.ones_like(a), b / a, a / b), axis=-1)


def _skewed_coefficients(state: PlateState) -> Array:
    """Coefficients of the strain energy of a parallelogram, (..., n_forms).

    Strains are G g with g the atoms on the reference square, so the coefficient of a pair of atoms
    is that entry of G^T C G times the area. With x = a xi + b eta sin s, y = b eta cos s:
    d/dx = 1/a d/dxi, d/dy = 1/(b cos s) d/deta - tan s / a d/dxi.
    """
    skew = np.asarray(state.skew)
    along = {"x": 1.0 / state.length, "y": -np.tan(skew) / state.length}
    across = {"x": 0.0 * along["x"], "y": 1.0 / (state.width * np.cos(skew))}
    shape = np.broadcast_shapes(*(np.shape(v) for v in (*along.values(), *across.values())))
    kind = np.result_type(*along.values(), *across.values())
    g = np.zeros((*shape, len(STRAIN_ATOMS), len(_ATOMS)), dtype=kind)
    for i, row in enumerate(STRAIN_ATOMS):
        for atom, size in row:
            if not size:
                g[..., i, _ATOMS.index(atom)] = 1.0
                continue
            axis: Literal["x", "y"] = "x" if size == "length" else "y"
            g[..., i, _ATOMS.index(Atom(atom.field, "x"))] += along[axis]
            g[..., i, _ATOMS.index(Atom(atom.field, "y"))] += across[axis]
    both = np.swapaxes(g, -1, -2) @ state.stiffness() @ g
    return np.asarray(both[..., _LEFT, _RIGHT] * state.area[..., None])


def inertia_coefficients(state: PlateState, values: Values) -> Array:
    """Coefficients of the kinetic energy, (..., 5): rho h for u, v, w, the integral of rho z^2 for rotations.

    The latter is rho h^3 / 12 for a plate of uniform density.
    """
    del values
    translation = state.density * state.thickness * state.length * state.width
    if state.skew is not None:
        translation = translation * np.cos(state.skew)
    rotation = translation * state.thickness**2 / 12
    if state.plies is not None:
        rotation = rotation * state.plies.mass_moments[1]
    both = np.stack(np.broadcast_arrays(translation, rotation), axis=-1)
    return both.take((0, 0, 0, 1, 1), axis=-1)


def mass_offset_coefficients(state: PlateState, values: Values) -> Array:
    """Coefficients of the integral of rho z, which couples u with phi_x and v with phi_y, (..., 2)."""
    first = 0.0 if state.plies is None else state.plies.mass_moments[0]
    translation = inertia_coefficients(state, values)[..., :1]
    offset = translation * (first * np.asarray(state.thickness)[..., None])
    return np.concatenate((offset, offset), axis=-1)


LAMINATE_TERM = Term("laminate", "stiffness", LAMINATE_FORMS, laminate_coefficients)
INERTIA_TERM = Term("inertia", "mass", MASS_FORMS, inertia_coefficients)
MASS_OFFSET_TERM = Term(
    "mass offset",
    "mass",
    (Form(Atom("u"), Atom("phi_x")), Form(Atom("v"), Atom("phi_y"))),
    mass_offset_coefficients,
)
"""Mass coupling of a plate whose upper half is heavier or lighter than the lower."""
# Distance of the centre of mass from the midplane, over the thickness, that is mere rounding.
_CENTRED = 1e-9


def everything(values: Values) -> NDArray[np.bool_]:
    """True for all parameter values."""
    return np.ones(np.broadcast_shapes(*(np.shape(v) for v in values.values())), dtype=bool)


def bare_plate(
    parameters: ParameterSet,
    edges: str,
    nominal: PlateState,
    state: StateFunction,
    admissible: Admissible = everything,
) -> Problem:
    """The plate without any effect: first-order shear deformation with rotary inertia, in vacuum.

    Raises ``ValueError`` if ``edges`` is not four of F, S, C.
    """
    if not is_stated(edges):
        raise ValueError(f"edges: got {edges!r}, expected four of F, S, C (x=0, y=0, x=length, y=width)")
    centred = nominal.plies is None or abs(nominal.plies.mass_moments[0]) < _CENTRED
    terms = (LAMINATE_TERM, INERTIA_TERM) if centred else (LAMINATE_TERM, INERTIA_TERM, MASS_OFFSET_TERM)
    return Problem(parameters, edges, nominal, state, terms, admissible)


@lru_cache(maxsize=1024)
def rigid_body_count(edges: str) -> int:
    """Number of rigid-body motions that the edges leave free, from the rank of the fields held or sprung.

    The motions are u = c1 - c3 y, v = c2 + c3 x, w = c4 - c5 x - c6 y, phi_x = c5, phi_y = c6.
    """
    rows = []
    for name, condition in zip(EDGES, conditions(edges), strict=True):
        axis, level = name[0], float(name[1])
        for t in (0.0, 1.0):
            x, y = (level, t) if axis == "x" else (t, level)
            motion = {
                "u": (1, 0, -y, 0, 0, 0),
                "v": (0, 1, x, 0, 0, 0),
                "w": (0, 0, 0, 1, -x, -y),
                "phi_x": (0, 0, 0, 0, 1, 0),
                "phi_y": (0, 0, 0, 0, 0, 1),
            }
            rows += [motion[field] for field in (*condition.held(axis), *condition.sprung)]
    return 6 - (int(np.linalg.matrix_rank(np.array(rows, dtype=float))) if rows else 0)
