"""`identify` of a layup with unknown angles: fuzzy swarms first, then the constants of what it found."""

import json
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from cpam_bayes.forward_model.model import converged_model, reference_vector
from tests.stacking.cases import specimen_with

Run = Callable[..., tuple[object, str, str]]

TRUE = "[30/-60]_s"
SHORT = ("--quiet", "--iterations", 15, "--particles", 12)
PLATE = """\
name = "plate"

[plate]
length_mm = 260.0
width_mm = 190.0
thickness_mm = 3.2
density_kg_m3 = 1590.0
layup = "[?/?]_s"
edges = "FFFF"

[material]
isotropic = false
E1_GPa = 121.2
E2_GPa = 9.34
nu12 = 0.23
G12_GPa = 6.25

[unknowns]
E1_GPa = [80.0, 160.0]
E2_GPa = [5.0, 20.0]
nu12 = [0.15, 0.4]
G12_GPa = [4.0, 10.0]
angle_grid_deg = 30.0

[measurement]
frequencies_hz = FREQUENCIES
resolution_hz = 1.0
"""


@pytest.fixture(scope="module")
def frequencies() -> np.ndarray:
    """Of the layup that is to be found, with the reference constants."""
    own = specimen_with(np.arange(1.0, 7.0), TRUE, 30.0)
    found: np.ndarray = (
        converged_model(own, own.unknowns, 6).predict(reference_vector(own, own.unknowns)).frequencies[0]
    )
    return found


@pytest.fixture
def path(tmp_path: Path, frequencies: np.ndarray) -> Path:
    file = tmp_path / "plate.toml"
    file.write_text(
        PLATE.replace("FREQUENCIES", str([round(float(f)) for f in frequencies])), encoding="utf-8"
    )
    return file


@pytest.mark.slow
def test_the_angles_come_with_the_constants(run: Run, path: Path) -> None:
    status, out, _ = run("identify", path, *SHORT, "--json")
    found = json.loads(out)
    assert status == 0
    assert len(found["angles_deg"]) == 2
    assert set(found["angles_deg"]) <= {-60.0, -30.0, 0.0, 30.0, 60.0, 90.0}
    # the swarm may stop at a lesser sequence: the constants are those of what it says
    angles = "/".join(f"{a:g}" for a in found["angles_deg"])
    known = path.with_name("known.toml")
    known.write_text(path.read_text(encoding="utf-8").replace("?/?", angles), encoding="utf-8")
    again = json.loads(run("identify", known, *SHORT, "--json")[1])
    assert again["constants"] == found["constants"]
    assert found["forward_solves"] > again["forward_solves"]
    assert "angles_deg" not in again


@pytest.mark.slow
def test_the_screen_says_who_found_the_angles(run: Run, path: Path) -> None:
    status, out, _ = run("identify", path, *SHORT, "--verbose")
    assert status == 0
    assert "Best angles found: " in out
    assert "[?/?]_s asked for" in out
    assert re.search(r"found by \d+ fuzzy swarms", out)
