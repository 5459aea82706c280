"""A weighed plate that is thinner than stated, and what the commands say of sizes."""

from pathlib import Path

import numpy as np
import pytest

import cpam_bayes as cb
from cpam_bayes.diagnosis.cases import plate_case
from cpam_bayes.diagnosis.comparison import PlateCase
from cpam_bayes.inference.ensemble import EnsembleSettings
from cpam_bayes.plate import parse_specimen
from cpam_bayes.questions.diagnose.claim import scale_errors_of
from tests.diagnosed import diagnosed
from tests.plate_file import PLATE

WEIGHED = PLATE.replace("density_kg_m3 = 2700.0", "mass_g = 680.4")
KNOWN = WEIGHED.replace("nu12 = 0.33\n", "nu12 = 0.33\n\n[material.sd]\nE1_GPa = 0.69\nnu12 = 0.0033\n", 1)


def gauged(text: str) -> str:
    """A plate file whose thickness is stated to 0.1 %."""
    return text.replace("[material]\n", "[plate.sd]\nthickness_mm = 0.003\n\n[material]\n", 1)


def with_list(text: str, thickness_mm: float, source: str = "x") -> PlateCase:
    """A plate of 3 mm by its file, with the list of one of another thickness and the same mass."""
    f = cb.forward(parse_specimen(text.replace("= 3.0", f"= {thickness_mm}", 1), "x"), n_modes=8).frequencies
    listed = f"\n[measurement]\nfrequencies_hz = {[round(float(v), 2) for v in f]}\nrelative_std = 0.001\n"
    return plate_case(parse_specimen(text + listed, source))


def thickness_of(cases: list[PlateCase]) -> tuple[float, float, float]:
    """Of the cause: probability, and mean and standard deviation of its size."""
    found = diagnosed(cases, ["thickness"], gain=False)
    cause = next(c for c in found.causes if c.name == "thickness")
    mean, sd, _ = cause.parameters["thickness_deviation"]
    return cause.probability, mean, sd


@pytest.mark.parametrize(
    ("text", "thinner"), [(KNOWN, 0.05), (gauged(KNOWN), 0.04)], ids=["usual tolerance", "gauged"]
)
def test_a_weighed_plate_of_a_known_material_that_is_thinner_is_found_so(text: str, thinner: float) -> None:
    # five times the usual tolerance; at four the probability is 0.6, and 1 of a gauge of 0.1 %
    probability, mean, sd = thickness_of([with_list(text, 3.0 * (1.0 - thinner))])
    assert probability > 0.95
    # f^2 goes with E h^3 / m: 1 % of E is 0.33 % of h, less what the prior of h says
    assert sd == pytest.approx(0.0028, abs=0.0008)
    assert mean == pytest.approx(-thinner, abs=0.001)


def test_a_weighed_plate_that_is_4_percent_thinner_than_stated_is_so_beside_a_sister_plate() -> None:
    text = gauged(WEIGHED).replace("[material]\n", '[material]\nname = "aluminium"\n')
    plates = {"thin": 2.88, "sister": 3.0}
    cases = [with_list(text.replace("plate 7", name), h, name) for name, h in plates.items()]
    probability, mean, sd = thickness_of(cases)
    assert probability > 0.5
    # E differs between plates by 2.5 % or so, which is 0.9 % of h
    assert sd == pytest.approx(0.009, abs=0.002)
    assert mean == pytest.approx(-0.04, abs=0.002)


def test_all_commands_say_the_same_of_an_error_of_a_size(tmp_path: Path) -> None:
    path = tmp_path / "plate.toml"
    f = cb.forward(parse_specimen(WEIGHED, "x"), n_modes=8).frequencies.tolist()
    listed = f"\n[measurement]\nfrequencies_hz = {f}\nrelative_std = 0.002\n"
    path.write_text(WEIGHED + listed, encoding="utf-8")
    settings = EnsembleSettings(walkers=16, round_steps=100, effective=200.0, most_steps=400)
    identified = cb.identify(path, seed=1).estimate.scale_errors
    sampled = cb.sample(path, seed=1, settings=settings).scale_errors
    specimen = cb.read_plate(path)
    found = diagnosed([plate_case(specimen)], ["frequency_scale"], gain=False)
    diagnosis = scale_errors_of(found, found.cases[0].models.specimen)
    for one, *others in zip(identified, sampled, diagnosis, strict=True):
        for other in others:
            assert other.name == one.name
            for constant in ("E1", "nu12"):
                assert np.isclose(other.shift[constant], one.shift[constant], rtol=0.02, atol=0.02)
