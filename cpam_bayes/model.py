"""From parameters to predicted frequencies: the forward model that every back end asks."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.affine import AffineOperator
from cpam_bayes.convergence import Tolerance, converge, rich_frequencies
from cpam_bayes.effects import add_known_mass
from cpam_bayes.elasticity import complete_constants, is_admissible
from cpam_bayes.laminate import ENERGY_CONSISTENT, ShearModel, laminate_geometry
from cpam_bayes.measurement.records import Specimen
from cpam_bayes.modes import Spectrum, energy_terms, solve
from cpam_bayes.parameters import ParameterSet
from cpam_bayes.problem import PlateState, Problem, Values, bare_plate
from cpam_bayes.shapes import Mode, describe_modes

Array = NDArray[Any]

NO_PARAMETERS = ParameterSet(())
# Step of the complex-step derivative, relative to a parameter: any small number does, no digits go.
_STEP = 1e-25
# A space is converged at constants this far from the reference, as a fraction.
_NEIGHBOURHOOD = 0.3


def plate_problem(
    specimen: Specimen,
    parameters: ParameterSet = NO_PARAMETERS,
    shear: ShearModel = ENERGY_CONSISTENT,
) -> Problem:
    """The plate of a specimen as an eigenvalue problem in some of its elastic constants.

    parameters : the constants that vary; the others keep their reference value, G13, G23 and the
    constants of an isotropic plate following eq. (6) and (11) where they are not given. Raises
    ``ValueError`` if the layup has unknown angles.
    """
    plate = specimen.plate
    if plate.layup.n_unknown:
        raise ValueError(
            f"layup {plate.layup.text} has {plate.layup.n_unknown} unknown angles; "
            "a known layup is needed"
        )
    nominal = PlateState(
        length=np.asarray(plate.length),
        width=np.asarray(plate.width),
        thickness=np.asarray(plate.thickness),
        density=np.asarray(plate.density),
        constants=complete_constants(specimen.material.constants, specimen.material.isotropic),
        layup=laminate_geometry(plate.layup.angles_deg),
        shear=shear,
    )

    def state(values: Values) -> PlateState:
        own = {k: v for k, v in values.items() if k in parameters}
        constants = {**specimen.material.constants, **own}
        return replace(
            nominal, constants=complete_constants(constants, specimen.material.isotropic)
        )

    problem = bare_plate(parameters, plate.edges, nominal, state)
    for sensor in specimen.sensors:
        problem = add_known_mass(problem, sensor.mass, sensor.x, sensor.y)
    return problem


@dataclass(frozen=True, slots=True)
class Prediction:
    """Predicted frequencies of m parameter sets.

    frequencies : (m, n_modes) Hz. jacobian : (m, n_modes, n_parameters), Hz per unit of the
    parameter, or ``None``.
    """

    frequencies: Array
    jacobian: Array | None


@dataclass(frozen=True, slots=True)
class PlateModel:
    """A converged plate: parameter vectors in, frequencies out.

    error : (n_modes,) estimated relative error of each frequency.
    """

    operator: AffineOperator[Any, Any]
    n_modes: int
    error: Array

    @property
    def parameters(self) -> ParameterSet:
        """The parameters that vary, in the order of the vectors."""
        return self.operator.problem.parameters

    def spectrum(self, x: Array, *, vectors: bool = False) -> Spectrum:
        """Modes at parameter vectors (m, n)."""
        stiffness, mass = self._coefficients(np.atleast_2d(x))
        return solve(self.operator, stiffness, mass, self.n_modes, vectors=vectors)

    def predict(self, x: Array, *, jacobian: bool = False) -> Prediction:
        """Frequencies at parameter vectors (m, n) and, if asked, their derivatives.

        d f / d p = phi^T (dK/dp - lambda dM/dp) phi / (8 pi^2 f), phi M-normalised.
        """
        x = np.atleast_2d(x)
        spectrum = self.spectrum(x, vectors=jacobian)
        f = spectrum.frequencies
        if not jacobian:
            return Prediction(f, None)
        k_energy, m_energy = energy_terms(self.operator, spectrum)
        dk, dm = self._coefficient_derivatives(x)
        lam = spectrum.eigenvalues[..., None]
        d_lambda = k_energy @ dk - lam * (m_energy @ dm)
        return Prediction(f, d_lambda / (8 * np.pi**2 * f[..., None]))

    def modes(self, x: Array) -> tuple[Mode, ...]:
        """Frequencies, kinds and labels at one parameter vector (n,)."""
        spectrum = self.spectrum(x, vectors=True)
        _, mass = self._coefficients(np.atleast_2d(x))
        return describe_modes(self.operator, spectrum, mass)

    def _coefficients(self, x: Array) -> tuple[Array, Array]:
        """Coefficients of K and M at parameter vectors (m, n), (m, n_terms) each."""
        found = self.operator.coefficients(self.parameters.mapping(x))
        k, m = (np.broadcast_to(c, (len(x), c.shape[-1])) for c in found)
        return k, m

    def _coefficient_derivatives(self, x: Array) -> tuple[Array, Array]:
        """d theta_q / d p_j by complex step, (m, n_terms, n_parameters) each."""
        m, n = x.shape
        step = _STEP * np.maximum(np.abs(x), np.finfo(float).tiny ** 0.25)
        shifted = x[:, None, :] + 1j * step[:, None, :] * np.eye(n)
        found = self._coefficients(shifted.reshape(m * n, n))
        k, mass = (np.swapaxes(c.imag.reshape(m, n, -1) / step[:, :, None], 1, 2) for c in found)
        return k, mass


def reference_samples(specimen: Specimen, parameters: ParameterSet, n: int = 3) -> Array:
    """The reference constants and n admissible sets within 30 % of them, (n + 1, n_parameters).

    They tell a discretisation what it will be asked; the seed is fixed so that a model does not
    depend on a run's. Values are brought within the bounds of the parameters.
    """
    rng = np.random.default_rng(0)
    constants, isotropic = specimen.material.constants, specimen.material.isotropic
    complete = complete_constants(constants, isotropic)
    centre = np.array([float(complete[name]) for name in parameters.names])
    found = [centre]
    while parameters.size and len(found) <= n:
        factor = 1.0 + _NEIGHBOURHOOD * rng.uniform(-1.0, 1.0, parameters.size)
        x = np.clip(centre * factor, parameters.lower, parameters.upper)
        if is_admissible({**constants, **parameters.mapping(x)}, isotropic):
            found.append(x)
    return np.array(found)


def converged_model(
    specimen: Specimen,
    parameters: ParameterSet,
    n_modes: int,
    shear: ShearModel = ENERGY_CONSISTENT,
    tolerance: Tolerance | None = None,
    at: Array | None = None,
) -> PlateModel:
    """The plate of a specimen on a Ritz space that is converged about given constants.

    parameters : the constants that vary (``NO_PARAMETERS`` for the reference ones alone). at : the
    parameter vectors (m, n) to converge at, by default the reference constants and their
    neighbourhood.
    """
    problem = plate_problem(specimen, parameters, shear)
    x = reference_samples(specimen, parameters) if at is None else np.atleast_2d(at)
    samples = parameters.mapping(x)
    converged = converge(problem, samples, n_modes, tolerance)
    return PlateModel(converged.operator, n_modes, converged.error)


def discretisation_error(model: PlateModel, x: Array) -> Array:
    """Estimated relative error of the frequencies of a model at one parameter vector, (n_modes,).

    The model's frequencies against those of a space converged at this very place, plus the error of
    that space. It holds where the model was not converged for, at the end of a search for instance.
    """
    x = np.atleast_2d(x)
    problem = model.operator.problem
    finer = rich_frequencies(problem, model.parameters.mapping(x), model.n_modes)
    difference = np.abs(model.predict(x).frequencies / finer.frequencies - 1.0)
    return np.asarray(difference.max(axis=0) + finer.error)
