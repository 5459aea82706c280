"""Finite elements: the 8-node serendipity quadrilateral with reduced integration, by scikit-fem.

The element that ABAQUS calls S8R. All five fields share one scalar basis. Strain energies take 2 x 2 Gauss
points per element: full integration would lock as the plate gets thin. Kinetic energies take 3 x 3, which is
exact: with 2 x 2 points the mass of eight nodes has rank four, and modes without mass would appear. In the
affine operators of such spaces all terms share one sparsity pattern.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import scipy.linalg
from numpy.typing import NDArray
from scipy.sparse import coo_array, csc_array, csr_array, diags_array
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import LinearOperator, eigsh, splu
from skfem import CellBasis, ElementQuadS2, MeshQuad1
from skfem.mapping import MappingIsoparametric
from skfem.quadrature import get_quadrature

from cpam_bayes.formatting import listed
from cpam_bayes.mechanics.affine import AffineOperator, ModeVectors
from cpam_bayes.mechanics.dense import MATRICES, active_terms, projected_functions
from cpam_bayes.mechanics.mesh_file import read_mesh
from cpam_bayes.mechanics.problem import (
    AREA,
    MEMBRANE_FIELDS,
    Derivative,
    Form,
    MatrixKind,
    PlateState,
    Problem,
    Region,
    Values,
)
from cpam_bayes.mechanics.ritz import Quadrature, layer_rates
from cpam_bayes.plate.edges import CONDITIONS, EDGES, FIELDS, STATED, Field, conditions

Array = NDArray[Any]

# Polynomial degree integrated by the rules of 2 x 2 and 3 x 3 points.
REDUCED, FULL = 3, 5
# Uniform elements along the longer side, and the least along the shorter.
_LONGER, _SHORTER = 24, 16
# Least width of an element, as a fraction of the side: thinner ones cost digits and gain nothing.
_THINNEST = 2e-4
# Points per element for a part of an edge: its ends are met to within a thousandth of the edge.
_MIDPOINTS = 64
# Distance from the mesh, in units of the plate, at which a point still counts as on it.
_ON_MESH = 1e-6


@dataclass(frozen=True, slots=True)
class Grading:
    """Widths of the elements along the edges.

    first : of the outermost one, in decay lengths of the edge layer.
    growth : ratio of each further one to the one before.
    """

    first: float = 0.25
    growth: float = 3.0


DEFAULT_GRADING = Grading()


@dataclass(frozen=True, slots=True)
class ElementQuadrature(Quadrature):
    """A rule with its elements. cells : (m,) their numbers; local : (2, m, n_points / m) coordinates."""

    cells: Array
    local: Array


@dataclass(frozen=True)
class FemSpace:
    """Serendipity trial functions of the five fields on a mesh in reference coordinates.

    basis : the scalar basis with the reduced rule.
    free : its unknowns that are free in each field.
    facets : boundary facets of the named edges.
    size : nominal length and width, m.
    stiffness_degree : polynomial degree integrated by the rule of the stiffness.
    """

    basis: Any
    free: Mapping[Field, Array]
    facets: Mapping[str, Array]
    size: tuple[float, float]
    stiffness_degree: int = REDUCED

    @property
    def n_elements(self) -> int:
        """Number of elements."""
        return int(self.basis.mesh.nelements)

    @property
    def extent(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Least and greatest x, and y, of the mesh, m."""
        nodes = self.basis.mesh.doflocs
        low, high = nodes.min(axis=1), nodes.max(axis=1)
        x, y = ((float(a * s), float(b * s)) for a, b, s in zip(low, high, self.size, strict=True))
        return x, y

    @property
    def area(self) -> float:
        """Area of the mesh, m2."""
        return float(self._area(AREA, FULL).weights.sum()) * self.size[0] * self.size[1]

    def covers(self, points: Array) -> Array:
        """True where points (n, 2) in reference coordinates are on the mesh, (n,) bool."""
        on_mesh = np.zeros(len(points), dtype=bool)
        on_mesh[self._locate(points)[0]] = True
        return on_mesh

    def dimension(self, field: Field) -> int:
        """Number of trial functions of a field."""
        return len(self.free[field])

    def quadrature(self, region: Region, matrix: Literal["stiffness", "mass"] = "stiffness") -> Quadrature:
        """Points and weights of a region.

        The area has 2 x 2 points per element for forms of the stiffness and 3 x 3 for those of the
        mass. An edge has three points per element; its weights add up to its length in units of the
        plate's nominal width (x0, x1) or length (y0, y1). Raises ``ValueError`` for an edge that
        the mesh does not name and for a point that is not on the mesh.
        """
        if region.kind in ("area", "projection"):
            return self._area(region, self.stiffness_degree if matrix == "stiffness" else FULL)
        return self._edge(region) if region.kind == "edge" else self._point(region)

    def evaluate(self, field: Field, quadrature: Quadrature, derivative: Derivative) -> csr_array[Any]:
        """Trial functions of a field at points, sparse (n_points, dimension), zero off the mesh."""
        if isinstance(quadrature, ElementQuadrature):
            values = self._values(quadrature.cells, quadrature.local, derivative)
        else:
            inside, cells, local = self._locate(quadrature.points)
            values = self._values(cells, local, derivative)
            at = coo_array(
                (np.ones(len(inside)), (inside, np.arange(len(inside)))),
                shape=(len(quadrature.points), len(inside)),
            )
            values = at.tocsr() @ values
        return values[:, self.free[field]]

    def _values(self, cells: Array, local: Array, derivative: Derivative) -> csr_array[Any]:
        """All scalar functions or a derivative of them at local points of cells, (n_points, N)."""
        basis = self.basis
        shape = (len(cells), local.shape[2], basis.Nbfun)
        values = np.empty(shape)
        for k in range(basis.Nbfun):
            field = basis.elem.gbasis(basis.mapping, local, k, tind=cells)[0]
            values[..., k] = field.grad["xy".index(derivative)] if derivative else np.asarray(field)
        columns = np.broadcast_to(basis.dofs.element_dofs[:, cells].T[:, None, :], shape)
        starts = np.arange(0, values.size + 1, basis.Nbfun)
        return csr_array((values.ravel(), columns.ravel(), starts), shape=(len(starts) - 1, basis.N))

    def _area(self, region: Region, degree: int) -> Quadrature:
        mapping, cells = self.basis.mapping, np.arange(self.n_elements)
        x, w = get_quadrature(self.basis.mesh.refdom, degree)
        local = np.broadcast_to(x[:, None, :], (2, len(cells), x.shape[1]))
        points = mapping.F(local, tind=cells)
        weights = np.abs(mapping.detDF(local, tind=cells)) * w
        return ElementQuadrature(region, points.reshape(2, -1).T, weights.ravel(), cells, local)

    def _edge(self, region: Region) -> Quadrature:
        if region.edge not in self.facets:
            raise ValueError(
                f"edge {region.edge!r} is not on the mesh, which has {sorted(self.facets)}; "
                "name its lines so in the mesh"
            )
        mapping, find = self.basis.mapping, self.facets[region.edge]
        cells = self.basis.mesh.f2t[0, find]
        x, w = get_quadrature(self.basis.mesh.brefdom, FULL)
        part = region.span != (0.0, 1.0)
        if part:  # its ends lie anywhere in an element
            x, w = (np.arange(_MIDPOINTS) + 0.5)[None] / _MIDPOINTS, np.full(_MIDPOINTS, 1.0 / _MIDPOINTS)
        points = mapping.G(x, find=find)
        local = mapping.invF(points, tind=cells)
        along = self.size[1 if region.edge[0] == "x" else 0]
        stretch = [self.size[i] / along * mapping.bndJ(i, 0, x, find=find) for i in (0, 1)]
        weights = np.hypot(*stretch) * w
        if part:
            t = points[1 if region.edge[0] == "x" else 0]
            weights = np.where((t >= region.span[0]) & (t <= region.span[1]), weights, 0.0)
        return ElementQuadrature(region, points.reshape(2, -1).T, weights.ravel(), cells, local)

    def _point(self, region: Region) -> Quadrature:
        points = np.array([region.point])
        inside, cells, local = self._locate(points)
        if not len(inside):
            place = tuple(float(c * s) for c, s in zip(region.point, self.size, strict=True))
            raise ValueError(
                f"point (x, y) = ({place[0]:g}, {place[1]:g}) m is not on the plate's mesh; "
                "give a point of the plate, not of a hole or beyond its outline"
            )
        return ElementQuadrature(region, points, np.ones(1), cells, local)

    def _locate(self, points: Array) -> tuple[Array, Array, Array]:
        """Indices of the points (n, 2) that are on the mesh, their elements and local coordinates."""
        mesh = self.basis.mesh
        nodes = mesh.doflocs[:, mesh.dofs.element_dofs]
        low, high = nodes.min(axis=1), nodes.max(axis=1)
        slack = 0.1 * (high - low) + _ON_MESH  # a curved side bulges beyond its nodes
        x = points.T[:, :, None]
        near = ((x >= (low - slack)[:, None]) & (x <= (high + slack)[:, None])).all(axis=0)
        which, cells = np.nonzero(near)
        target = points[which].T[:, :, None]
        mapping = MappingIsoparametric(mesh, mesh.elem(), mesh.bndelem)
        local = np.full(target.shape, 0.5)
        for _ in range(20 if len(which) else 0):
            miss = target - mapping.F(local, tind=cells)
            step = np.einsum("ijkl,jkl->ikl", mapping.invDF(local, tind=cells), miss)
            local = np.clip(local + step, 0.0, 1.0)
        miss = target - mapping.F(local, tind=cells)
        inside = np.flatnonzero(np.abs(miss).max(axis=(0, 2)) < _ON_MESH)
        located, first = np.unique(which[inside], return_index=True)
        keep = inside[first]
        return located, cells[keep], local[:, keep]


def fem_space(
    edges: str,
    nominal: PlateState,
    nx: int | None = None,
    ny: int | None = None,
    *,
    grading: Grading | None = DEFAULT_GRADING,
) -> FemSpace:
    """Elements for a rectangular plate with the given edges.

    edges : four of F, S, C for x = 0, y = 0, x = length, y = width.
    nx, ny : elements along x and y before grading; by default about square ones. ``grading`` subdivides the
    outermost ones, down to a quarter of the decay length of a free edge's twisting layer; it also resolves
    the singular corner of a clamped and a free edge. ``None`` leaves them whole.

    With the default counts frequencies of six to ten modes are within 0.05 % of converged ones
    for h / a from 1/10 to 1/1000; beyond, the locking that remains with reduced integration grows like
    (a / h)^2. Raises ``ValueError`` for counts below one.
    """
    size = _size(nominal)
    counts = [n if n is not None else d for n, d in zip((nx, ny), default_counts(nominal), strict=True)]
    if min(counts) < 1:
        raise ValueError(f"elements along x and y: received {counts}, accepted: 1 or more")
    h = float(np.real(nominal.thickness))
    cuts = [
        _cuts(n, h / rate / s, grading) for n, s, rate in zip(counts, size, layer_rates(nominal), strict=True)
    ]
    mesh = MeshQuad1.init_tensor(*cuts)
    boundary = mesh.boundary_facets()
    middle = mesh.p[:, mesh.facets[:, boundary]].mean(axis=1)
    facets = {
        name: boundary[np.isclose(middle["xy".index(name[0])], float(name[1]), atol=1e-12)] for name in EDGES
    }
    return _space(mesh, facets, edges, size)


def fem_space_from_mesh(path: str | Path, edges: str, nominal: PlateState, *, unit: float = 1e-3) -> FemSpace:
    """Elements read from a file: any outline, with holes, of 4-, 8- or 9-node quadrilaterals.

    The file has the plate's own coordinates, x and y from the corner x = y = 0, in units of
    ``unit`` metres: by default millimetres, like the plate file. The nominal length and width only
    scale it to reference coordinates, so a plate whose length varies is the mesh stretched. Lines in
    groups named x0, y0, x1, y1 get the conditions of ``edges``, in this order; other boundary is free.
    S needs an edge along its axis: on an oblique one the held fields would be the wrong ones.

    Raises ``ValueError`` for a file or mesh that cannot be used, and says why.
    """
    size = _size(nominal)
    held = tuple(name for name, c in zip(EDGES, conditions(edges), strict=True) if not c.is_free)
    mesh, facets = read_mesh(Path(path), (unit / size[0], unit / size[1]), held)
    space = _space(mesh, facets, edges, size)
    anywhere = [letter for letter in STATED if not CONDITIONS[letter].follows_axis]
    for name, condition in zip(EDGES, conditions(edges), strict=True):
        if condition.follows_axis and not _along_its_axis(space, name):
            raise ValueError(
                f"mesh {path}: edge {name!r} is {condition.name} but not one straight line of "
                f"constant {name[0]}; accepted on other lines: {listed(anywhere, 'and')}"
            )
    return space


def default_counts(nominal: PlateState) -> tuple[int, int]:
    """Default numbers of elements along x and y in ``fem_space``, before grading."""
    size = _size(nominal)
    nx, ny = (max(_SHORTER, round(_LONGER * s / max(size))) for s in size)
    return nx, ny


def _size(nominal: PlateState) -> tuple[float, float]:
    return float(np.real(nominal.length)), float(np.real(nominal.width))


def _cuts(n: int, layer: float, grading: Grading | None) -> Array:
    """Ends of n equal elements of [0, 1], the outermost cut into ones that grow inwards by ``grading``."""
    if grading is None:
        return np.linspace(0.0, 1.0, n + 1)
    inside: list[float] = []
    step = max(grading.first * layer, _THINNEST)
    while sum(inside) + grading.growth * step / 2 < 1.0 / max(n, 2) and len(inside) < 6:
        inside.append(step)
        step *= grading.growth
    strips = np.cumsum(inside)
    return np.unique(np.concatenate((np.linspace(0.0, 1.0, n + 1), strips, 1.0 - strips)))


def _space(mesh: Any, facets: Mapping[str, Array], edges: str, size: tuple[float, float]) -> FemSpace:
    basis = CellBasis(mesh, ElementQuadS2(), intorder=REDUCED)
    held: dict[Field, list[Array]] = {field: [] for field in FIELDS}
    for name, condition in zip(EDGES, conditions(edges), strict=True):
        for field in condition.held(name):
            held[field].append(basis.get_dofs(facets[name]).all())
    everything = np.arange(basis.N)
    free = {field: np.setdiff1d(everything, np.concatenate([[], *parts])) for field, parts in held.items()}
    return FemSpace(basis, free, facets, size)


def _along_its_axis(space: FemSpace, name: str) -> bool:
    nodes = space.basis.get_dofs(space.facets[name]).all()
    return bool(np.ptp(space.basis.doflocs["xy".index(name[0]), nodes]) < _ON_MESH)


# Eigenvalues beyond those requested: Lanczos finds the second of an equal pair late.
_SPARE = 2


@dataclass(frozen=True)
class Pattern:
    """A sparsity pattern of square matrices (n, n), by columns.

    rows, columns : (n_entries,), columns ascending and rows ascending in each.
    starts : (n + 1,), first entry of each column.
    """

    rows: Array
    columns: Array
    starts: Array

    @property
    def n(self) -> int:
        """Number of columns."""
        return len(self.starts) - 1

    def matrix(self, entries: Array) -> csc_array[Any]:
        """The matrix with these entries; it shares the pattern's arrays, which are read-only."""
        return csc_array((entries, self.rows, self.starts), shape=(self.n, self.n))


def _pattern(keys: Array, n: int) -> Pattern:
    """The pattern of ascending keys row + n * column."""
    rows, columns = (keys % n).astype(np.int32), (keys // n).astype(np.int32)
    starts = np.searchsorted(columns, np.arange(n + 1)).astype(np.int32)
    for array in (rows, columns, starts):
        array.flags.writeable = False
    return Pattern(rows, columns, starts)


@dataclass(frozen=True)
class SparseAffineMatrix:
    """A symmetric matrix that is a sum of fixed matrices times coefficients, on one pattern.

    data : (n_active, n_entries) entries of the matrices, sparse since a form couples two fields only.
    active : (n_active,) the coefficients to which they belong.
    """

    pattern: Pattern
    data: csr_array[Any]
    active: Array

    def entries(self, coefficients: Array) -> Array:
        """Entries of the matrix at coefficients (n_terms,), (n_entries,)."""
        return np.asarray(coefficients[self.active] @ self.data)

    def assemble(self, coefficients: Array) -> csc_array[Any]:
        """The matrix at coefficients (n_terms,)."""
        return self.pattern.matrix(self.entries(coefficients))

    def energies(self, vector: Array) -> Array:
        """phi^T K_q phi of a vector (n,) for every active matrix, (n_active,)."""
        return np.asarray(self.data @ (vector[self.pattern.rows] * vector[self.pattern.columns]))


@dataclass(frozen=True)
class SparseBlock:
    """A block of a sparse space.

    index : (n,) positions of its trial functions in the whole space.
    shift : (rad/s)^2, negative, the point nearest to which eigenvalues are sought; it makes the stiffness of
    a free plate regular.
    """

    stiffness: SparseAffineMatrix
    mass: SparseAffineMatrix
    index: Array
    shift: float
    n_terms: tuple[int, int]

    @property
    def size(self) -> int:
        """Number of trial functions."""
        return len(self.index)

    def eigenvalues(self, stiffness: Array, mass: Array, n: int) -> Array:
        """The n lowest eigenvalues of m coefficient sets, (m, n).

        Lanczos iteration on (K - shift M)^-1 M, from a start vector that is always the same.
        """
        return np.stack([lam for lam, _ in self._each_lowest(stiffness, mass, n)])

    def eigenpairs(self, stiffness: Array, mass: Array, n: int) -> tuple[Array, ModeVectors]:
        """The n lowest eigenvalues of m coefficient sets, (m, n), and a function for their vectors.

        By the iteration of ``eigenvalues``, which finds both.
        """
        values, vectors = zip(*self._each_lowest(stiffness, mass, n), strict=True)
        stacked = np.stack(vectors)
        return np.stack(values), lambda sets, column: stacked[sets, :, column]

    def _each_lowest(self, stiffness: Array, mass: Array, n: int) -> Iterator[tuple[Array, Array]]:
        """The n lowest eigenvalues (n,) and vectors (size, n) of each coefficient set."""
        for i in range(max(len(stiffness), len(mass))):
            yield self._lowest(stiffness, mass, i, n)

    def _lowest(self, stiffness: Array, mass: Array, i: int, n: int) -> tuple[Array, Array]:
        """The n lowest eigenvalues (n,) and vectors (size, n) of coefficient set i."""
        pattern = self.stiffness.pattern
        # coefficients that all sets share are given once
        k = self.stiffness.entries(stiffness[min(i, len(stiffness) - 1)])
        m = self.mass.entries(mass[min(i, len(mass) - 1)])
        if n + _SPARE >= self.size:
            return scipy.linalg.eigh(
                pattern.matrix(k).toarray(), pattern.matrix(m).toarray(), subset_by_index=(0, n - 1)
            )
        # positive definite, so that no pivoting is needed and the ordering may be symmetric
        factor = splu(
            pattern.matrix(k - self.shift * m),
            permc_spec="MMD_AT_PLUS_A",
            diag_pivot_thresh=0.0,
            options={"SymmetricMode": True},
        )
        inertia = pattern.matrix(m).copy()
        inertia.eliminate_zeros()
        lam, phi = eigsh(
            pattern.matrix(k),
            k=n + _SPARE,
            M=inertia,
            sigma=self.shift,
            OPinv=LinearOperator((self.size, self.size), matvec=factor.solve, dtype=float),
            v0=np.random.default_rng(0).standard_normal(self.size),
        )
        order = np.argsort(lam)[:n]
        return lam[order], phi[:, order]

    def energies(self, vectors: Array) -> tuple[Array, Array]:
        """phi^T K_q phi and phi^T M_q phi of vectors (k, size) for each term, (k, n_terms) both."""
        terms = []
        for matrix, n_terms in zip((self.stiffness, self.mass), self.n_terms, strict=True):
            energy = np.zeros((len(vectors), n_terms))
            for row, vector in zip(energy, vectors, strict=True):
                row[matrix.active] = matrix.energies(vector)
            terms.append(energy)
        return terms[0], terms[1]


SparseOperator = AffineOperator[FemSpace, SparseBlock]


def discretise_sparse(problem: Problem, space: FemSpace, samples: Values) -> SparseOperator:
    """The problem on a sparse space, split into the fields that couple at any of the ``samples``.

    samples : parameter values, each (n_samples,), that cover the range of use: forms whose
    coefficient is zero at all of them are left out. A symmetric laminate gives a membrane and a
    bending block.
    """
    active = {kind: np.flatnonzero(active_terms(problem, samples, kind)).tolist() for kind in MATRICES}
    forms = {kind: problem.forms(kind) for kind in MATRICES}
    n_terms = (len(forms["stiffness"]), len(forms["mass"]))
    used = [forms[kind][q] for kind in MATRICES for q in active[kind]]
    starts = dict(zip(FIELDS, np.cumsum([0, *(space.dimension(f) for f in FIELDS)]), strict=False))
    blocks = []
    for fields in _coupled_fields(used):
        index = np.concatenate([starts[f] + np.arange(space.dimension(f)) for f in fields])
        if not len(index):
            continue
        local = dict(zip(fields, np.cumsum([0, *map(space.dimension, fields)]), strict=False))
        entries = {
            kind: [
                (q, *_form_entries(forms[kind][q], space, kind, local, len(index)))
                for q in active[kind]
                if forms[kind][q].left.field in fields
            ]
            for kind in MATRICES
        }
        keys = _sorted_unique([k for kind in MATRICES for _, k, _ in entries[kind]])
        pattern = _pattern(keys, len(index))
        stiffness, mass = (_on_pattern(pattern, keys, entries[kind]) for kind in MATRICES)
        shift = -_reference_eigenvalue(problem.nominal, fields)
        blocks.append(SparseBlock(stiffness, mass, index, shift, n_terms))
    return AffineOperator(problem, space, tuple(blocks))


def _coupled_fields(forms: list[Form]) -> list[tuple[Field, ...]]:
    """Groups of fields that no form couples with each other."""
    pairs = np.array([(FIELDS.index(f.left.field), FIELDS.index(f.right.field)) for f in forms]).T
    n = len(FIELDS)
    graph = coo_array((np.ones(pairs.shape[1]), tuple(pairs)), shape=(n, n))
    count, label = connected_components(graph, directed=False)
    return [tuple(f for f, x in zip(FIELDS, label, strict=True) if x == c) for c in range(count)]


def _form_entries(
    form: Form, space: FemSpace, kind: MatrixKind, starts: dict[Field, int], n: int
) -> tuple[Array, Array]:
    """Keys and values of a form's entries in a block of n functions, both triangles."""
    rule = space.quadrature(form.region, kind)
    left = space.evaluate(form.left.field, rule, form.left.derivative)
    right = space.evaluate(form.right.field, rule, form.right.derivative)
    if form.region.kind == "projection":  # every function with every other: dense
        functions = projected_functions(form, rule)
        matrix = coo_array((left.T @ functions) @ (right.T @ functions).T)
    else:
        weights = rule.weights * (1.0 if form.weight is None else form.weight(rule.points))
        weighting: csr_array[Any] = diags_array(weights, format="csr")
        matrix = coo_array(left.T @ weighting @ right)
    rows = matrix.row.astype(np.int64) + starts[form.left.field]
    columns = matrix.col.astype(np.int64) + starts[form.right.field]
    if form.left == form.right:
        return rows + n * columns, matrix.data
    keys = np.concatenate((rows + n * columns, columns + n * rows))
    return keys, np.concatenate((matrix.data, matrix.data))


def _sorted_unique(parts: list[Array]) -> Array:
    """Sorted unique integers; hashing, as in ``np.unique``, is ten times slower for millions of them."""
    keys = np.sort(np.concatenate(parts))
    return keys[np.concatenate(([True], keys[1:] > keys[:-1]))]


def _on_pattern(pattern: Pattern, keys: Array, entries: list[tuple[int, Array, Array]]) -> SparseAffineMatrix:
    active = np.array([q for q, _, _ in entries], dtype=int)
    rows = np.concatenate([np.full(len(k), i) for i, (_, k, _) in enumerate(entries)])
    places = np.searchsorted(keys, np.concatenate([k for _, k, _ in entries]))
    values = np.concatenate([v for _, _, v in entries])
    data = coo_array((values, (rows, places)), shape=(len(active), len(keys)))
    return SparseAffineMatrix(pattern, data.tocsr(), active)


def _reference_eigenvalue(nominal: PlateState, fields: tuple[Field, ...]) -> float:
    """An eigenvalue of the order of the lowest, (rad/s)^2: ten times the estimate from a strip's rigidity."""
    k, h = np.real(nominal.stiffness()), float(np.real(nominal.thickness))
    length, width = float(np.real(nominal.length)), float(np.real(nominal.width))
    if set(fields) <= set(MEMBRANE_FIELDS):
        rigidity = min(k[0, 0] / length**2, k[1, 1] / width**2)
    else:
        rigidity = min(k[3, 3] / length**4, k[4, 4] / width**4)
    return float(10.0 * rigidity / (h * float(np.real(nominal.density))))
