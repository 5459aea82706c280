"""The reduced model: its errors, its estimate of them, its derivatives and its store."""

from __future__ import annotations

import pickle
from dataclasses import dataclass, replace
from functools import cache
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from cpam_bayes.forward_model.store import model_key, reduced_model

from cpam_bayes.forward_model.model import (
    PlateModel,
    angle_parameters,
    converged_model,
    convergence_samples,
    plate_problem,
    reference_vector,
    size_parameters,
)
from cpam_bayes.forward_model.reduced import (
    DEFAULT_SETTINGS,
    ReducedModel,
    ReductionSettings,
    reduce,
)
from cpam_bayes.mechanics.convergence import Tolerance, rich_frequencies
from cpam_bayes.mechanics.problem import rigid_body_count
from cpam_bayes.parameters import ParameterSet
from cpam_bayes.plate import Specimen, read_specimen
from cpam_bayes.plate.laminate import ENERGY_CONSISTENT, FIVE_SIXTHS, ShearModel

N_DRAWS = 1000
FIXED = ("B1", "D1")
ANY = "C1 with unknown angles"
cases = pytest.mark.parametrize("name", [*FIXED, pytest.param(ANY, marks=pytest.mark.slow)])


def specimen_of(name: str) -> Specimen:
    return read_specimen("C1").with_unknown_angles() if name == ANY else read_specimen(name)


def parameters_of(specimen: Specimen) -> ParameterSet:
    return specimen.unknowns.union(angle_parameters(specimen))


def n_modes_of(specimen: Specimen) -> int:
    return specimen.measurement.size


@cache
def reduced(name: str) -> ReducedModel:
    specimen = specimen_of(name)
    full = converged_model(specimen, parameters_of(specimen), n_modes_of(specimen))
    return reduce(full, np.random.default_rng(0))


def prior_draws(model: PlateModel, n: int, seed: int) -> np.ndarray:
    """Admissible draws from the prior, others than the model was built from, (n, n_parameters)."""
    x = model.parameters.sample(np.random.default_rng(seed), 4 * n)
    return np.asarray(x[model.admissible(x)][:n])


@dataclass(frozen=True, slots=True)
class Comparison:
    """True errors and their estimates at prior draws, (n_draws, n_modes) each."""

    x: np.ndarray
    error: np.ndarray
    estimate: np.ndarray


@cache
def compared(name: str) -> Comparison:
    model = reduced(name)
    x = prior_draws(model.full, N_DRAWS, seed=1234)
    assert len(x) == N_DRAWS
    error = model.predict(x).frequencies / model.full.predict(x).frequencies - 1.0
    return Comparison(x, error, model.error(x))


# Errors and their estimates


@cases
def test_true_error_is_below_its_estimate_in_99_of_100_draws(name: str) -> None:
    # a draw counts only if all of its frequencies do
    below = np.all(np.abs(compared(name).error) <= compared(name).estimate, axis=1)
    assert below.mean() >= 0.99


@cases
def test_estimate_is_at_most_ten_times_the_error_in_the_median(name: str) -> None:
    ratio = compared(name).estimate / np.abs(compared(name).error)
    assert 1.0 <= np.median(ratio) <= 10.0


@cases
def test_error_is_below_1e_4_in_99_of_100_draws(name: str) -> None:
    assert np.quantile(compared(name).error, 0.99) < 1e-4
    assert np.quantile(compared(name).error.max(axis=1), 0.99) < 2e-4, "of the worst frequency of a draw"


@cases
def test_reduced_frequencies_are_never_below_the_full_ones(name: str) -> None:
    # the reduced space is part of the full one; rounding is what the estimate says of it
    model = reduced(name)
    lam = (2 * np.pi * model.full.predict(compared(name).x[:1]).frequencies) ** 2
    rounding = 10.0 * float(model.rounding) / lam.min()
    assert rounding < 1e-6
    assert compared(name).error.min() > -rounding


@cases
def test_estimate_holds_on_the_corners_of_the_prior_box(name: str) -> None:
    # optima sit on bounds
    model = reduced(name)
    lower, upper = model.full.parameters.lower, model.full.parameters.upper
    corners = np.array(list(product(*zip(lower, upper, strict=True))))
    corners = corners[model.full.admissible(corners)][:: 1 + len(corners) // 64]
    error = np.abs(model.predict(corners).frequencies / model.full.predict(corners).frequencies - 1.0)
    # corners are trained: what is left of the error there is rounding, 1e-11
    below = error <= model.error(corners) + 1e-9
    assert len(corners) >= 8
    assert below.mean() >= 0.99
    assert error.max() < 5e-3, "far from every draw of the prior, and said to be"


@pytest.mark.parametrize("name", FIXED)
def test_estimate_follows_the_error_over_the_orders_of_magnitude(name: str) -> None:
    # a model of a hundredth of the accuracy must say so by itself
    full = reduced(name).full
    settings = ReductionSettings(tolerance=1e-2, training=20, checks=20, rounds=1)
    coarse = reduce(full, np.random.default_rng(3), settings)
    x = compared(name).x[:200]
    error = coarse.predict(x).frequencies / full.predict(x).frequencies - 1.0
    estimate = coarse.error(x)
    assert np.quantile(error, 0.9) > 1e-4
    assert np.mean(error <= estimate) >= 0.99
    assert np.corrcoef(np.log(np.maximum(error, 1e-12)).ravel(), np.log(estimate).ravel())[0, 1] > 0.8


@pytest.mark.parametrize("n_modes", [6, 8])
def test_no_mode_of_the_square_isotropic_plate_is_lost(n_modes: int) -> None:
    # its modes come in equal pairs, which lie in two blocks and of which a basis can lack one: all
    # frequencies above a lost one are then those of the next mode, wrong by per cents
    specimen = read_specimen("D&G")
    full = converged_model(specimen, specimen.unknowns, n_modes)
    model = reduce(full, np.random.default_rng(0))
    x = prior_draws(full, 300, seed=5)
    exact = full.predict(x).frequencies
    gap = np.diff(exact, axis=1) / exact[:, :-1]
    assert gap.min() < 1e-6, "there is a pair"
    error = np.abs(model.predict(x).frequencies / exact - 1.0)
    # the full solve rounds too, by 1e-9 with some kernels of BLAS
    assert np.all(error <= model.error(x) + 3e-9)
    assert error.max() < 1e-4


def test_usual_layups_are_among_the_samples_of_unknown_angles() -> None:
    specimen = specimen_of(ANY)
    problem = plate_problem(specimen, parameters_of(specimen))
    samples = convergence_samples(specimen, problem)
    angles = samples.x[samples.allowance == 1.0][:, -4:].tolist()
    for layup in ([0.0] * 4, [90.0] * 4, [0.0, 90.0] * 2, [45.0, -45.0] * 2):
        assert layup in angles
    assert np.all(problem.admissible(problem.parameters.mapping(samples.x)))
    known = read_specimen("C1")
    fixed = convergence_samples(known, plate_problem(known, known.unknowns))
    assert len(fixed.x) == len(samples.x) - 4


@pytest.mark.slow
def test_printed_error_of_any_layup_holds_on_the_usual_layups() -> None:
    full = reduced(ANY).full
    parameters = full.parameters
    x = np.tile(reference_vector(specimen_of(ANY), parameters), (6, 1))
    x[:, -4:] = [
        *([0, 90, 0, 90], [90, 0, 90, 0], [0, 0, 0, 0], [90, 90, 90, 90]),
        *([45, -45, 45, -45], [0, 0, 90, 90]),
    ]
    tight = Tolerance(kept=1e-6, rich=2e-6, largest_degree=22)
    exact = rich_frequencies(full.operator.problem, parameters.mapping(x), 6, tight)
    error = np.abs(full.predict(x).frequencies / exact.frequencies - 1.0)
    assert exact.error.max() < 2e-5
    assert np.all(error <= full.error + exact.error)
    assert full.error.max() < 2e-4, "what is promised of a thin plate"


# What the reduced model shares with the full one


@cases
def test_reduced_derivatives_are_the_full_ones(name: str) -> None:
    model = reduced(name)
    x = prior_draws(model.full, 25, seed=77)
    found = model.predict(x, jacobian=True).jacobian
    expected = model.full.predict(x, jacobian=True).jacobian
    assert found is not None
    assert expected is not None
    reach = model.full.parameters.upper - model.full.parameters.lower
    scale = np.abs(expected * reach).max(axis=-1, keepdims=True)
    np.testing.assert_array_less(np.abs(found - expected) * reach / scale, 1e-3)


@cases
def test_a_batch_is_what_its_members_are_alone(name: str) -> None:
    model = reduced(name)
    x = compared(name).x[:15]
    together = model.predict(x, jacobian=True)
    errors = model.error(x)
    reach = model.full.parameters.upper - model.full.parameters.lower
    for i, own in enumerate(x):
        alone = model.predict(own, jacobian=True)
        # sums in another order: 1e-16 of the terms of K, which cancel down to 1e-9 of themselves
        np.testing.assert_allclose(alone.frequencies[0], together.frequencies[i], rtol=1e-7)
        scale = np.abs(together.jacobian[i] * reach).max()
        np.testing.assert_allclose(
            alone.jacobian[0] * reach, together.jacobian[i] * reach, rtol=0, atol=1e-6 * scale
        )
        np.testing.assert_allclose(model.error(own)[0], errors[i], rtol=1e-2)


@cases
def test_reduced_model_keeps_blocks_and_rigid_body_motions(name: str) -> None:
    model = reduced(name)
    spectrum = model.fast.spectrum(compared(name).x[:3])
    assert spectrum.rigid.shape[1] == rigid_body_count("FFFF")
    assert np.all(np.abs(spectrum.rigid) < 1e-4 * spectrum.eigenvalues[:, :1])
    assert model.n_modes == model.full.n_modes == n_modes_of(specimen_of(name))
    assert max(b.size for b in model.fast.operator.blocks) <= (90 if name == ANY else 45)
    assert len(model.fast.operator.blocks) <= len(model.full.operator.blocks)


def test_a_tighter_tolerance_takes_a_larger_basis_and_errs_less() -> None:
    full = reduced("B1").full
    x = compared("B1").x[:100]
    exact = full.predict(x).frequencies
    sizes, errors = [], []
    for tolerance in (1e-3, 1e-6):
        settings = ReductionSettings(tolerance=tolerance, training=60, checks=60)
        model = reduce(full, np.random.default_rng(0), settings)
        sizes.append(sum(b.size for b in model.fast.operator.blocks))
        errors.append(np.quantile(model.predict(x).frequencies / exact - 1.0, 0.99))
    assert sizes[0] < sizes[1]
    assert errors[1] < 1e-5 < errors[0]


def test_one_seed_gives_one_model() -> None:
    full = reduced("B1").full
    settings = ReductionSettings(training=30, checks=30, rounds=1)
    first, again = (reduce(full, np.random.default_rng(5), settings) for _ in range(2))
    x = compared("B1").x[:20]
    np.testing.assert_array_equal(first.predict(x).frequencies, again.predict(x).frequencies)
    np.testing.assert_array_equal(first.error(x), again.error(x))


# The store

QUICK = ReductionSettings(tolerance=1e-3, training=12, checks=12, rounds=1)


@pytest.fixture
def b1() -> Specimen:
    return read_specimen("B1")


def build(specimen: Specimen, directory: Path) -> tuple[ReducedModel, list[str]]:
    """A quick model of three modes, and what was said while it was made."""
    said: list[str] = []
    model = reduced_model(
        specimen, specimen.unknowns, 3, settings=QUICK, directory=directory, notify=said.append
    )
    return model, said


def same_bits(a: ReducedModel, b: ReducedModel) -> None:
    x = prior_draws(a.full, 20, seed=2)
    np.testing.assert_array_equal(a.predict(x).frequencies, b.predict(x).frequencies)
    np.testing.assert_array_equal(a.predict(x, jacobian=True).jacobian, b.predict(x, jacobian=True).jacobian)
    np.testing.assert_array_equal(a.full.predict(x).frequencies, b.full.predict(x).frequencies)
    np.testing.assert_array_equal(a.error(x), b.error(x))
    np.testing.assert_array_equal(a.full.error, b.full.error)


def test_a_stored_model_is_read_back_bit_for_bit(b1: Specimen, tmp_path: Path) -> None:
    built, said = build(b1, tmp_path / "new" / "folder")
    read, silence = build(b1, tmp_path / "new" / "folder")
    assert said
    assert not silence, "nothing is built that is there"
    same_bits(built, read)
    same_bits(built, pickle.loads(pickle.dumps(read)))  # on its way to a worker
    assert [path.suffix for path in (tmp_path / "new" / "folder").iterdir()] == [".arrays"]


def test_a_damaged_file_is_built_again(b1: Specimen, tmp_path: Path) -> None:
    built, _ = build(b1, tmp_path)
    (path,) = tmp_path.iterdir()
    content = bytearray(path.read_bytes())
    content[int(0.6 * len(content))] ^= 0xFF
    path.write_bytes(content)
    again, said = build(b1, tmp_path)
    assert said, "it was built, not read"
    assert path.with_name(f"{path.name}.damaged").exists()
    same_bits(built, again)
    assert not build(b1, tmp_path)[1], "and stored once more"


def key(
    specimen: Specimen,
    n_modes: int = 6,
    shear: ShearModel = ENERGY_CONSISTENT,
    settings: ReductionSettings = DEFAULT_SETTINGS,
    centre: np.ndarray | None = None,
    parameters: ParameterSet | None = None,
) -> str:
    own = specimen.unknowns if parameters is None else parameters
    return model_key(specimen, own, n_modes, shear, settings, centre)


def test_whatever_changes_the_model_changes_its_key(b1: Specimen) -> None:
    plate, material = b1.plate, b1.material
    changed = [
        replace(b1, plate=replace(plate, length=plate.length * 1.001)),
        replace(b1, plate=replace(plate, width=plate.width * 1.001)),
        replace(b1, plate=replace(plate, thickness=plate.thickness * 1.001)),
        replace(b1, plate=replace(plate, density=plate.density * 1.001)),
        replace(b1, plate=replace(plate, edges="CFFF")),
        replace(b1, plate=replace(plate, layup=read_specimen("C1").plate.layup)),
        replace(b1, plate=replace(plate, layup=read_specimen("B1").with_unknown_angles().plate.layup)),
        replace(b1, material=replace(material, symmetry="orthotropic")),
        replace(b1, material=replace(material, constants={**material.constants, "E1": 1e11})),
    ]
    gauged = replace(b1, plate=replace(plate, sd={"thickness": 2e-5}))
    centre = 0.5 * (b1.unknowns.lower + b1.unknowns.upper)
    keys = [key(b1), *(key(other) for other in changed)]
    keys += [
        key(b1, n_modes=7),
        key(b1, shear=FIVE_SIXTHS),
        key(b1, settings=QUICK),
        key(b1, centre=centre),
        key(b1, parameters=b1.unknowns.without("nu12")),
        key(b1, parameters=b1.unknowns.fix(nu12=0.23)),
        key(b1, parameters=b1.unknowns.fix(nu12=0.24)),
        key(b1, parameters=read_specimen("D1").unknowns),
        key(b1, parameters=b1.unknowns.union(size_parameters(gauged))),
    ]
    assert len(set(keys)) == len(keys)


def test_what_was_measured_is_no_part_of_the_key(b1: Specimen) -> None:
    assert key(replace(b1, measurement=None, name="other", source="elsewhere", notes=())) == key(b1)
