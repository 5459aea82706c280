"""8-node serendipity plates of first-order theory, with laminate theory of their own.

Strains and kinetic energy are sparse matrices from nodal values to quadrature points: K = B^T (w C) B with 2
x 2 points per element (the reduced rule, since full integration locks), M = N^T (w m) N with 3 x 3. A taper,
a soft patch, a stress or a dent changes C at these points, a crooked outline the positions of the nodes.
Laminate theory is written anew from the textbooks, so that an error in the laminates of the package cannot
hide in a truth: Jones, Mechanics of Composite Materials (A, B, D), and Rohwer, Composites Science and
Technology 32 (1988), for a transverse shear stiffness that is consistent in energy.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import block_diag, bsr_array, coo_array, csr_array, hstack, vstack
from scipy.sparse.linalg import LinearOperator, eigsh, splu
from skfem import CellBasis, ElementQuadS2, FacetBasis, MeshQuad1

Array = NDArray[np.float64]
Constants = Mapping[str, float]

# Shape of the plate as a map of the unit square: (2, n) to (2, n).
Outline = Callable[[Array], Array]

ELEMENTS = 16
# Width of the outermost elements relative to the others.
GRADING = 0.35
FIELDS = ("u", "v", "w", "phi_x", "phi_y")
EDGES = ("x0", "y0", "x1", "y1")


@dataclass(frozen=True, slots=True)
class Elements:
    """A mesh with its matrices.

    n : number of nodes; a field's value at node j is unknown field * n + j.
    points, weights : (2, q) m and (q,) m2 of the rule of the stiffness; unit : (2, q) on the unit square.
    value : (q, n) shape functions; slope : (q, n) along x and along y, both sparse.
    mass_points, mass_weights, mass_unit, mass_value : of the rule of the mass.
    edges : for each edge its points on the unit square (along it), weights in m and shape functions.
    held : for each edge the nodes on it.
    nodes : (2, n) on the unit square.
    shape : number of elements along x and y.
    """

    n: int
    points: Array
    weights: Array
    unit: Array
    value: csr_array[Any]
    slope: tuple[csr_array[Any], csr_array[Any]]
    mass_points: Array
    mass_weights: Array
    mass_unit: Array
    mass_value: csr_array[Any]
    edges: Mapping[str, tuple[Array, Array, csr_array[Any]]]
    held: Mapping[str, NDArray[np.int64]]
    nodes: Array
    shape: tuple[int, int]


class BucklingError(ValueError):
    """Error raised if the stress on a plate exceeds its buckling stress."""


def divisions(n: int, grading: float = GRADING) -> Array:
    """Positions of n + 1 nodes from 0 to 1, with narrower outermost intervals."""
    widths = np.ones(n)
    widths[[0, -1]] = grading
    return np.asarray(np.concatenate([[0.0], np.cumsum(widths)]) / widths.sum())


def elements(outline: Outline, n: tuple[int, int] = (ELEMENTS, ELEMENTS)) -> Elements:
    """The mesh of a quadrilateral plate: the image of a graded unit square."""
    grid = _unit_mesh(n)
    image = MeshQuad1(outline(np.asarray(grid.p)), grid.t)
    shape = ElementQuadS2()
    rules = {degree: CellBasis(image, shape, intorder=degree) for degree in (3, 5)}
    flat = {degree: CellBasis(grid, shape, intorder=degree) for degree in (3, 5)}
    value, slope_x, slope_y = _sampled(rules[3])
    mass_value, *_ = _sampled(rules[5])
    edges, held = {}, {}
    for edge in EDGES:
        axis, side = "xy".index(edge[0]), float(edge[1])
        facets = grid.facets_satisfying(lambda p, a=axis, s=side: np.abs(p[a] - s) < 1e-9)
        basis = FacetBasis(image, shape, facets=facets, intorder=5)
        along = FacetBasis(grid, shape, facets=facets, intorder=5).global_coordinates()[1 - axis]
        edges[edge] = (along.ravel(), basis.dx.ravel(), _sampled(basis)[0])
        held[edge] = np.unique(basis.get_dofs(facets).all())
    return Elements(
        n=rules[3].N,
        points=_places(rules[3]),
        weights=rules[3].dx.ravel(),
        unit=_places(flat[3]),
        value=value,
        slope=(slope_x, slope_y),
        mass_points=_places(rules[5]),
        mass_weights=rules[5].dx.ravel(),
        mass_unit=_places(flat[5]),
        mass_value=mass_value,
        edges=edges,
        held=held,
        nodes=np.asarray(flat[3].doflocs),
        shape=n,
    )


def strains(mesh: Elements, rise: tuple[Array, Array] | None = None) -> csr_array[Any]:
    """The eight strains at the points of the stiffness, point by point, (8 q, 5 n).

    rise : slopes of a shallow mid-surface at the points, through which w also stretches it (Marguerre).
    """
    n, x, y = mesh.value, *mesh.slope
    zero = csr_array(n.shape)
    flat = [zero, zero, zero]
    if rise is not None:
        up_x, up_y = (scaled(r, s) for r, s in zip(rise, mesh.slope, strict=True))
        flat = [up_x, up_y, scaled(rise[0], y) + scaled(rise[1], x)]
    rows = [
        [x, zero, flat[0], zero, zero],
        [zero, y, flat[1], zero, zero],
        [y, x, flat[2], zero, zero],
        [zero, zero, zero, x, zero],
        [zero, zero, zero, zero, y],
        [zero, zero, zero, y, x],
        [zero, zero, y, zero, n],
        [zero, zero, x, n, zero],
    ]
    stacked = vstack([hstack(row) for row in rows]).tocsr()
    q = n.shape[0]
    return csr_array(stacked[np.arange(8 * q).reshape(8, q).T.ravel()])


def stiffness(mesh: Elements, strain: csr_array[Any], c: Array) -> csr_array[Any]:
    """K for a laminate stiffness at every point, (q, 8, 8)."""
    blocks = bsr_array(
        (mesh.weights[:, None, None] * c, np.arange(len(c)), np.arange(len(c) + 1)),
        shape=(8 * len(c), 8 * len(c)),
    )
    return csr_array(strain.T @ (blocks @ strain))


def mass(mesh: Elements, per_area: Array, rotary: Array) -> csr_array[Any]:
    """M for a mass and a rotary inertia per area at the points of the mass rule, kg/m2 and kg."""
    shift, turn = (
        mesh.mass_value.T @ scaled(mesh.mass_weights * weight, mesh.mass_value)
        for weight in (per_area, rotary)
    )
    return csr_array(block_diag([shift, shift, shift, turn, turn]))


def on_field(mesh: Elements, field: str, small: csr_array[Any]) -> csr_array[Any]:
    """Embed the matrix of one field among all fields, (5 n, 5 n)."""
    entries = coo_array(small)
    at = FIELDS.index(field) * mesh.n
    return csr_array(
        coo_array((entries.data, (entries.row + at, entries.col + at)), shape=(5 * mesh.n, 5 * mesh.n))
    )


def edge_form(mesh: Elements, edge: str, density: Callable[[Array], Array]) -> csr_array[Any]:
    """Integral along an edge of a stiffness per length times the square of a field, (n, n)."""
    along, weights, value = mesh.edges[edge]
    return csr_array(value.T @ scaled(weights * density(along), value))


def at_points(mesh: Elements, places: Array) -> csr_array[Any]:
    """Shape functions at places (2, p) of the unit square, (p, n)."""
    # no element may be found for a place on the outline itself
    return csr_array(_unit_basis(mesh.shape).probes(np.clip(places, 1e-9, 1.0 - 1e-9)))


def frequencies(
    k: csr_array[Any], m: csr_array[Any], held: NDArray[np.int64], n_modes: int, rigid: int, about: float
) -> tuple[Array, Array]:
    """Lowest natural frequencies, Hz, without rigid-body motions, and their modes (5 n, n_modes).

    held : unknowns fixed to zero. rigid : motions left out. about : Hz, of the order of the lowest.
    """
    size = k.shape[0]
    free = np.setdiff1d(np.arange(size), held)
    kf, mf = (matrix.tocsc()[free][:, free] for matrix in (k, m))
    shift = -((2.0 * np.pi * about) ** 2) * 0.05
    # symmetric and positive definite; zero pivoting without the threshold would fill the factor
    factor = splu(
        (kf - shift * mf).tocsc(),
        permc_spec="MMD_AT_PLUS_A",
        diag_pivot_thresh=0.0,
        options={"SymmetricMode": True},
    )
    inverse = LinearOperator(kf.shape, matvec=factor.solve, dtype=np.float64)
    start = np.random.default_rng(0).standard_normal(len(free))
    values, vectors = eigsh(kf, n_modes + rigid, mf, sigma=shift, OPinv=inverse, v0=start, tol=1e-9)
    rank = np.argsort(values)[rigid:]
    if values[rank[0]] <= 0.0:
        raise BucklingError("the plate buckles: its lowest eigenvalue is not positive; take a smaller stress")
    modes = np.zeros((size, len(rank)))
    modes[free] = vectors[:, rank]
    return np.sqrt(np.abs(values[rank])) / (2.0 * np.pi), modes


@lru_cache(maxsize=8)
def _unit_mesh(n: tuple[int, int]) -> Any:
    return MeshQuad1.init_tensor(divisions(n[0]), divisions(n[1]))


@lru_cache(maxsize=8)
def _unit_basis(n: tuple[int, int]) -> CellBasis:
    return CellBasis(_unit_mesh(n), ElementQuadS2(), intorder=3)


def _sampled(basis: Any) -> list[csr_array[Any]]:
    """Shape functions and their slopes at the points of a rule, element by element, (q, n) each."""
    shape = np.asarray(basis.basis[0][0]).shape
    rows = np.arange(np.prod(shape)).reshape(shape)
    cells = basis.mesh.f2t[0, basis.find] if hasattr(basis, "find") and basis.find is not None else None
    dofs = basis.dofs.element_dofs if cells is None else basis.dofs.element_dofs[:, cells]
    out = []
    for pick in (np.asarray, lambda f: f.grad[0], lambda f: f.grad[1]):
        values = np.stack([pick(basis.basis[i][0]) for i in range(basis.Nbfun)])
        columns = np.broadcast_to(dofs[:, :, None], values.shape)
        row = np.broadcast_to(rows, values.shape)
        entries = (values.ravel(), (row.ravel(), columns.ravel()))
        out.append(csr_array(coo_array(entries, shape=(rows.size, basis.N))))
    return out


def _places(basis: Any) -> Array:
    return np.asarray(np.asarray(basis.global_coordinates()).reshape(2, -1))


def scaled(weights: Array, matrix: csr_array[Any]) -> csr_array[Any]:
    """A matrix with its rows multiplied by weights."""
    out = csr_array(matrix, copy=True)
    out.data = out.data * np.repeat(weights, np.diff(out.indptr))
    return out


# Laminates

# Cured epoxy, Pa (Daniel and Ishai, Engineering Mechanics of Composite Materials).
RESIN: dict[str, float] = {"E1": 3.5e9, "E2": 3.5e9, "nu12": 0.35, "G12": 3.5e9 / 2.7}


def completed(constants: Constants) -> dict[str, float]:
    """The six constants of a ply; by default G13 = G12 and G23 of a transversely isotropic ply.

    G23 = E2 / (2 (1 + nu23)), nu23 = nu12 (1 - nu12 E2 / E1) / (1 - nu12). Without E2: isotropic.
    """
    c = dict(constants)
    if "E2" not in c:
        shear = c["E1"] / (2.0 * (1.0 + c["nu12"]))
        return {"E1": c["E1"], "E2": c["E1"], "nu12": c["nu12"], "G12": shear, "G13": shear, "G23": shear}
    c.setdefault("G13", c["G12"])
    nu23 = c["nu12"] * (1.0 - c["nu12"] * c["E2"] / c["E1"]) / (1.0 - c["nu12"])
    c.setdefault("G23", c["E2"] / (2.0 * (1.0 + nu23)))
    return c


def plane_stress(c: Constants, angle_deg: float) -> Array:
    """Plane-stress stiffness of a ply in plate axes, (3, 3) Pa, order xx, yy, xy with gamma_xy."""
    minor = c["nu12"] * c["E2"] / c["E1"]
    scale = 1.0 / (1.0 - c["nu12"] * minor)
    q = np.array(
        [
            [scale * c["E1"], scale * minor * c["E1"], 0.0],
            [scale * minor * c["E1"], scale * c["E2"], 0.0],
            [0.0, 0.0, c["G12"]],
        ]
    )
    cos, sin = np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg))
    # strains in the ply's axes from those in the plate's
    turn = np.array(
        [
            [cos**2, sin**2, cos * sin],
            [sin**2, cos**2, -cos * sin],
            [-2 * cos * sin, 2 * cos * sin, cos**2 - sin**2],
        ]
    )
    return np.asarray(turn.T @ q @ turn)


def shear_stress(c: Constants, angle_deg: float) -> Array:
    """Transverse shear stiffness of a ply in plate axes, (2, 2) Pa, order yz, xz."""
    cos, sin = np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg))
    turn = np.array([[cos, -sin], [sin, cos]])  # gamma_23, gamma_13 from gamma_yz, gamma_xz
    return np.asarray(turn.T @ np.diag([c["G23"], c["G13"]]) @ turn)


def laminate_stiffness(
    plies: Sequence[tuple[Constants, float, float]], correction: float | None = None
) -> Array:
    """The 8 x 8 stiffness [A B; B D; A_s] of plies (constants, angle in deg, thickness in m), bottom to top.

    correction : factor on the integral of the shear stiffness; None: Rohwer's energy-consistent one.
    Strains: eps_x, eps_y, gamma_xy, kappa_x, kappa_y, kappa_xy, gamma_yz, gamma_xz.
    """
    faces = np.concatenate([[0.0], np.cumsum([t for _, _, t in plies])])
    faces -= faces[-1] / 2.0
    moduli = [plane_stress(c, angle) for c, angle, _ in plies]
    shears = [shear_stress(c, angle) for c, angle, _ in plies]
    out = np.zeros((8, 8))
    for k, q in enumerate(moduli):
        low, high = faces[k], faces[k + 1]
        out[:3, :3] += q * (high - low)
        out[:3, 3:6] += q * (high**2 - low**2) / 2.0
        out[3:6, 3:6] += q * (high**3 - low**3) / 3.0
        out[6:, 6:] += shears[k] * (high - low)
    out[3:6, :3] = out[:3, 3:6].T
    if correction is not None:
        out[6:, 6:] *= correction
    else:
        out[6:, 6:] = _energy_consistent(faces, moduli, shears, out)
    return out


def _energy_consistent(
    faces: Array, moduli: Sequence[Array], shears: Sequence[Array], abd: NDArray[Any]
) -> Array:
    """Shear stiffness with the energy of the stresses in equilibrium in cylindrical bending."""
    neutral = -np.linalg.solve(abd[:3, :3], abd[:3, 3:6])  # membrane strains due to bending, N = 0
    flexibility = np.linalg.inv(abd[3:6, 3:6] + abd[3:6, :3] @ neutral)
    points, weights = np.polynomial.legendre.leggauss(4)
    compliance = np.zeros((2, 2))
    below = np.zeros((3, 3))  # integral of Q (eps0 + z) from the lower face
    for k, q in enumerate(moduli):
        low, high = faces[k], faces[k + 1]
        z = low + (high - low) * (points + 1.0) / 2.0
        inverse = np.linalg.inv(shears[k])
        for zi, wi in zip(z, weights * (high - low) / 2.0, strict=True):
            a = -(below + q @ (neutral * (zi - low) + np.eye(3) * (zi**2 - low**2) / 2.0)) @ flexibility
            # tau_yz and tau_xz due to the forces V_y = M_y,y and V_x = M_x,x
            f = np.array([[a[1, 1], a[2, 0]], [a[2, 1], a[0, 0]]])
            compliance += wi * f.T @ inverse @ f
        below = below + q @ (neutral * (high - low) + np.eye(3) * (high**2 - low**2) / 2.0)
    return np.asarray(np.linalg.inv(compliance))
