"""Timed entries: our solvers, LAPACK alone on matrices of the same sizes, and the other solvers."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np

from benchmarks import peers
from benchmarks.building import STACK, Ours
from benchmarks.cases import Array, Case, Converged, worst_error
from benchmarks.timing import Call
from cpam_bayes.forward_model.model import PlateModel, plate_problem
from cpam_bayes.plate import Specimen
from cpam_bayes.plate.laminate import FIVE_SIXTHS

SizeT = TypeVar("SizeT")

FULL, FULL_DERIVATIVES = "ours, full", "ours, full with derivatives"
REDUCED, REDUCED_DERIVATIVES = "ours, reduced", "ours, reduced with derivatives"
LAPACK_FULL, LAPACK_REDUCED = "LAPACK alone, sizes of full", "LAPACK alone, sizes of reduced"
BENDING = ", bending only"
POLYNOMIAL = "polynomial Ritz"

# Enough for classical theory, whose own error is far larger.
_CLPT_DEGREE = 10
# Elements in the plane. S8R lacks a shear correction and does not reach the accuracy on D1 with any number
# of elements, hence the bricks.
_SHELLS = {"C1": 160, "D1": 144}
_BRICKS = {"D1": 320}
_QUICK_SHELLS = 16


@dataclass(frozen=True, slots=True)
class Entry:
    """A timed call that solves ``sets`` parameter sets, with its worst error and its number of unknowns."""

    case: str
    solver: str
    call: Call
    error: float | None
    size: str
    sets: int = 1

    @property
    def key(self) -> tuple[str, str]:
        """Case and solver."""
        return self.case, self.solver

    @property
    def is_peer(self) -> bool:
        """Whether it is another solver, neither ours nor LAPACK alone."""
        return not self.solver.startswith(("ours", "LAPACK"))


def our_entries(ours: Ours, known: Converged) -> list[Entry]:
    """Our solvers on a case, with their errors at the reference plate."""
    name, full, reduced = ours.case.name, ours.full, ours.reduced
    x, one = ours.x, ours.x[:1]
    error, few_error = (
        worst_error(model.predict(one).frequencies[0], known.energy_consistent) for model in (full, reduced)
    )
    size, few = _sizes(full), _sizes(reduced.fast)
    return [
        Entry(name, FULL, lambda: full.predict(one), error, size),
        Entry(name, FULL_DERIVATIVES, lambda: full.predict(one, jacobian=True), error, size),
        Entry(name, LAPACK_FULL, _lapack(full, one), None, size),
        Entry(name, REDUCED, lambda: reduced.predict(x), few_error, few, STACK),
        Entry(name, REDUCED_DERIVATIVES, lambda: reduced.predict(x, jacobian=True), few_error, few, STACK),
        Entry(name, LAPACK_REDUCED, _lapack(reduced.fast, x), None, few, STACK),
    ]


def _sizes(model: PlateModel) -> str:
    """Sizes of the blocks, without the tiny ones of a few rigid-body motions."""
    return "+".join(str(block.size) for block in model.operator.blocks if block.size > 4)


def _lapack(model: PlateModel, x: Array) -> Call:
    """Eigenvalues of the model's own assembled matrices: a lower bound for any arrangement of ours."""
    stiffness, _ = model.coefficients(x)
    stacks = [block.dense().stiffness.assemble(stiffness) for block in model.operator.blocks]
    return lambda: [np.linalg.eigvalsh(stack) for stack in stacks]


def peer_entries(case: Case, known: Converged, accuracy: float, quick: bool) -> list[Entry]:
    """The other solvers on a plate, each at the smallest size that reaches the accuracy."""
    name, n, specimen = case.name, case.n_modes, case.known()
    state = plate_problem(specimen, shear=FIVE_SIXTHS).nominal
    reference = known.five_sixths

    def peer(solver: str, size: str, call: Callable[[], Array], reference: Array = reference) -> Entry:
        return Entry(name, solver, call, worst_error(call(), reference), size)

    def smallest(solve: Callable[[SizeT], Array], sizes: Sequence[SizeT]) -> SizeT:
        good = (size for size in sizes if worst_error(solve(size), reference) <= accuracy)
        return next(good, sizes[-1])

    mesh = smallest(lambda m: peers.serendipity(state, m, n, 3), _meshes(specimen))
    degree = smallest(lambda d: peers.polynomial(state, d, n, 3), range(6, 24))
    elements, terms = f"{mesh[0]} x {mesh[1]} elements", f"{degree} x {degree} terms"
    found = [
        peer("scikit-fem S2", elements, lambda: peers.serendipity(state, mesh, n)),
        peer("scikit-fem S2" + BENDING, elements, lambda: peers.serendipity(state, mesh, n, 3)),
        peer(POLYNOMIAL, terms, lambda: peers.polynomial(state, degree, n)),
        peer(POLYNOMIAL + BENDING, terms, lambda: peers.polynomial(state, degree, n, 3)),
    ]
    if peers.has_panels():
        angles = specimen.plate.layup.angles_deg
        # its functions span the same polynomials
        shear = smallest(lambda d: peers.panels_plate(state, angles, d, n, "fsdt"), range(degree, degree + 3))
        for theory, d in (("fsdt", shear), ("clpt", _CLPT_DEGREE)):
            call = _panels_call(state, angles, d, n, theory)
            found.append(peer(f"panels {theory.upper()}", f"{d} x {d} terms", call))
    if peers.has_calculix():
        shells = _QUICK_SHELLS if quick else _SHELLS[name]
        call = _calculix_call(specimen, "shell", shells, n)
        found.append(peer("CalculiX S8R", f"{shells} elements", call))
        if name in _BRICKS and not quick:
            bricks = _BRICKS[name]
            call = _calculix_call(specimen, "brick", bricks, n)
            found.append(
                peer("CalculiX C3D20R", f"{bricks} columns of bricks", call, known.energy_consistent)
            )
    return found


def _panels_call(state: Any, angles: Array, degree: int, n: int, theory: Any) -> Callable[[], Array]:
    return lambda: peers.panels_plate(state, angles, degree, n, theory)


def _calculix_call(specimen: Specimen, element: Any, count: int, n: int) -> Callable[[], Array]:
    return lambda: peers.calculix(specimen, element, count, n)


def _meshes(specimen: Specimen) -> list[tuple[int, int]]:
    """Numbers of elements along x and y with aspect ratios from 0.7 to 1.3, fewest elements first."""
    aspect = specimen.plate.length / specimen.plate.width
    found = {
        (max(4, round(ny * aspect * stretch)), ny)
        for ny in range(4, 17)
        for stretch in (0.7, 0.8, 0.9, 1.0, 1.15, 1.3)
    }
    return sorted(found, key=lambda mesh: (mesh[0] * mesh[1], mesh))
