"""The posterior of a former plate as prior: reading, its density, refusals."""

import copy
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.stats import multivariate_normal

import cpam_bayes as cb
from cpam_bayes.errors import PlateFileError
from cpam_bayes.inference.scores import Expansion, NormalScores
from tests.plate_file import described
from tests.posteriors import write_posterior

pytestmark = pytest.mark.usefixtures("folder")
MEAN = np.array([np.log(120.0), np.log(9.0), 0.3, np.log(5.0)])
CORRELATION = np.array([[1, 0.9, -0.3, 0.8], [0.9, 1, 0, 0.7], [-0.3, 0, 1, -0.2], [0.8, 0.7, -0.2, 1]])
UNKNOWNS = {"E1_GPa": [60.0, 200.0], "E2_GPa": [5.0, 20.0], "nu12": [0.1, 0.5], "G12_GPa": [2.0, 10.0]}
SIZE = 300.0, 220.0, 2.0
PLATE = described(SIZE, 1550.0, {"posterior": "former.nc"}, layup="[0_8]", unknowns=UNKNOWNS, name="sister")
NORMAL = {"mean": 0.3, "sd": 0.02, "bounds": [0.1, 0.5]}


def logs(sd: float | list[float] = 0.02) -> np.ndarray:
    """Draws (20000, 4) of the logarithms of moduli and of Poisson's ratio."""
    normal = np.random.default_rng(1).standard_normal((20_000, 4))
    return MEAN + normal @ np.linalg.cholesky(CORRELATION).T * sd


def named(x: np.ndarray) -> dict[str, np.ndarray]:
    return {name: v if name == "nu12" else np.exp(v) for name, v in zip(UNKNOWNS, x.T, strict=True)}


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    write_posterior(tmp_path / "former.nc", named(logs()), symmetry="transversely_isotropic")
    return tmp_path


def in_logs(x: np.ndarray) -> np.ndarray:
    return np.column_stack([np.log(x[:, :2] / 1e9), x[:, 2], np.log(x[:, 3] / 1e9)])


def test_the_prior_is_the_multivariate_normal_of_the_draws() -> None:
    unknowns, drawn = cb.read_plate(PLATE).unknowns, logs()
    x = unknowns.sample(np.random.default_rng(2), 20_000)
    assert unknowns.names == ("E1", "E2", "nu12", "G12")
    assert_allclose(in_logs(x).mean(axis=0), drawn.mean(axis=0), atol=0.04 * 0.02)  # standard errors: 0.007
    assert_allclose(np.corrcoef(in_logs(x).T), np.corrcoef(drawn.T), atol=0.03)
    normal = multivariate_normal(drawn.mean(axis=0), np.cov(drawn.T, bias=True))
    moduli = np.log(x[:5, [0, 1, 3]]).sum(axis=1)
    assert_allclose(unknowns.log_prior(x[:5]), normal.logpdf(in_logs(x[:5])) - moduli, atol=1e-6)


def test_scores_are_independent_whatever_the_priors_are() -> None:
    scores = NormalScores(cb.read_plate(PLATE).unknowns)
    z = np.random.default_rng(3).standard_normal((6, 4))
    x = scores.to_x(z)
    assert_allclose(scores.to_z(x), z, atol=1e-9)
    slope = scores.by_score(np.broadcast_to(np.eye(4), (6, 4, 4)), x, z)
    volume = np.linalg.slogdet(slope)[1]
    assert_allclose(scores.parameters.log_prior(x) + volume, scores.log_prior(z), atol=1e-9)
    step = 1e-6 * np.eye(4)
    by_difference = (scores.to_x(z[:1] + step) - scores.to_x(z[:1] - step)).T / 2e-6
    assert_allclose(slope[0], by_difference, rtol=1e-6, atol=1e-6 * np.abs(slope[0]).max(axis=1).min())


def test_derivatives_over_scores_are_those_of_the_density() -> None:
    scores = NormalScores(cb.read_plate(PLATE).unknowns)
    a = np.array([[1e-11, 2e-10, 3.0, 1e-10], [0.0, 1e-10, -1.0, 2e-10]])

    def expand(z: np.ndarray) -> Expansion:
        r = scores.to_x(z) @ a.T - 2.0
        fisher = np.tile(a.T @ a, (len(z), 1, 1))
        return scores.with_prior(Expansion(-0.5 * np.sum(r**2, axis=1), -r @ a, fisher), scores.to_x(z), z)

    z, step = np.array([[0.4, -1.0, 0.3, 1.2]]), 1e-5 * np.eye(4)
    difference = (expand(z + step).value - expand(z - step).value) / 2e-5
    assert_allclose(expand(z).gradient[0], difference, rtol=1e-5, atol=1e-7)
    by_score = scores.by_score(a[None], scores.to_x(z), z)[0]
    assert_allclose(expand(z).curvature[0], by_score.T @ by_score + np.eye(4), rtol=1e-12)


def test_next_to_a_bound_mean_and_scatter_are_those_of_the_draws_however_flat(folder: Path) -> None:
    wide = logs([0.02, 0.02, 0.15, 0.02])
    inside = wide[(wide[:, 2] > 0.1) & (wide[:, 2] < 0.5)]
    write_posterior(folder / "former.nc", named(inside))
    prior = cb.read_plate(PLATE).unknowns["nu12"].prior
    assert (prior.lower, prior.upper) == (0.1, 0.5)
    assert prior.mean == pytest.approx(inside[:, 2].mean(), abs=1e-6)
    assert prior.sd == pytest.approx(inside[:, 2].std(), abs=1e-6)
    assert prior.describe().scale == pytest.approx(0.15, rel=0.1)
    flat = logs()  # an open constant keeps a flat prior
    flat[:, 2] = np.random.default_rng(4).uniform(0.1, 0.5, len(flat))
    write_posterior(folder / "former.nc", named(flat))
    prior = cb.read_plate(PLATE).unknowns["nu12"].prior
    assert_allclose(prior.log_density(np.array([0.101, 0.3, 0.499])), -np.log(0.4), atol=0.1)


def test_reference_constants_that_are_left_out_are_the_means() -> None:
    plate = copy.deepcopy(PLATE)
    material = cb.read_plate(plate).material
    assert material.symmetry == "transversely_isotropic"
    assert material.constants["E1"] == pytest.approx(np.exp(logs()[:, 0]).mean() * 1e9)
    plate["material"]["E1_GPa"] = 110.0
    assert cb.read_plate(plate).material.constants["E1"] == 110e9


def test_a_material_of_a_hybrid_has_its_own_posterior(folder: Path) -> None:
    plate = copy.deepcopy(PLATE)
    plate["plate"]["layup"] = "[c0/g90/c0]"
    plies = (("c", "carbon", 0.5), ("g", "glass", 1.0))
    plate["ply"] = [{"name": name, "material": of, "thickness_mm": t} for name, of, t in plies]
    glass = {"E1_GPa": 40.0, "E2_GPa": 9.0, "nu12": 0.28, "G12_GPa": 3.5}
    plate["material"] = {"carbon": {"posterior": "former.nc"}, "glass": glass}
    plate["unknowns"] = {"carbon": PLATE["unknowns"], "glass": {"E1_GPa": [20.0, 80.0]}}
    unknowns = cb.read_plate(plate).unknowns
    correlation = unknowns.root @ unknowns.root.T
    assert_allclose(correlation[:4, :4], CORRELATION, atol=0.03)
    np.testing.assert_array_equal(correlation[4], np.eye(5)[4])
    draws = named(logs())
    write_posterior(folder / "former.nc", {f"carbon.{name}": v for name, v in draws.items()})
    assert cb.read_plate(plate).unknowns.root is not None


def of(**material: Any) -> dict[str, Any]:
    return {"material": material}


def unknown(**constants: Any) -> dict[str, Any]:
    return {"unknowns": constants}


ALUMINIUM = of(isotropic=True, E1_GPa=70.0, nu12=0.3, posterior="former.nc") | unknown()
REFUSED: dict[str, dict[str, Any]] = {
    "material.posterior: gone.nc: no file there": of(posterior="gone.nc"),
    "material.posterior: other.nc: no draws of elastic constants": of(posterior="other.nc"),
    "material.posterior: text.nc: cannot be read as NetCDF": of(posterior="text.nc"),
    "material.posterior: knows E1_GPa E2_GPa nu12 G12_GPa, accepted: one of the [unknowns], G23_GPa": unknown(
        G23_GPa=[1.0, 6.0]
    ),
    "material.sd.E1_GPa: beside material.posterior, which is a prior of E1_GPa too": of(
        posterior="former.nc", sd={"E1_GPa": 3.0}
    ),
    "unknowns.nu12: beside material.posterior": unknown(nu12=NORMAL),
    "material.posterior: 0 of its 20000 draws are within the bounds of [unknowns]": unknown(
        E1_GPa=[150.0, 200.0]
    ),
    "material.posterior: of a material that is transversely_iso": ALUMINIUM,
}


@pytest.mark.parametrize("said", REFUSED)
def test_a_posterior_that_cannot_be_the_prior_is_one_problem(folder: Path, said: str) -> None:
    write_posterior(folder / "other.nc", {"height_mm": np.arange(5.0)})
    (folder / "text.nc").write_text("frequencies")
    with pytest.raises(PlateFileError) as error:
        cb.read_plate({**PLATE, **REFUSED[said]})
    (problem,) = str(error.value).splitlines()
    assert f"sister: {said}" in problem


def test_the_swarm_of_the_paper_refuses_a_former_posterior() -> None:
    plate = {**PLATE, "measurement": {"frequencies_hz": [50.0, 80.0, 100.0, 150.0, 200.0]}}
    with pytest.raises(ValueError, match='accepted: "whitened", which alone uses a prior'):
        cb.identify(plate, residuals="absolute")
