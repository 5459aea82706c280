"""Decks of plates in ABAQUS format: mesh, plies, edges, and reading of results, without CalculiX."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from cpam_bayes.forward_model.calculix import run
from cpam_bayes.forward_model.calculix.deck import Element, grid_lines, plate_deck
from cpam_bayes.forward_model.calculix.run import CalculixError, deformation_modes, run_deck
from cpam_bayes.plate import Material, Sensor, Specimen, builtin
from cpam_bayes.plate.layup import parse_layup
from tests.plates import with_plate

N_MODES = 6
MISSING = -1.0
C1 = builtin("C1")
ONE_TOO_MANY, ONE_TOO_FEW = ([-0.15, 0.02, 4e5, 1e6], 1), ([-0.15, 0.02, 4e5, 1e6], 3)
OTHERS = [([0.02, 4e5, 1e6], 0), ([0.1, -4e5, 1e6], 1), ([0.1], 1)]
NO_DECK: dict[str, tuple[Specimen, dict[str, float]]] = {
    "2 unknown angles": (with_plate("C1", layup=parse_layup("[(?/?)_2]_s")), {}),
    r"outline from plate\.msh": (with_plate("C1", mesh=Path("plate.msh")), {}),
    "800 layers": (with_plate("C1", layup=parse_layup("[(0/90)_400]")), {}),
    "G23 missing": (C1, {"G23": MISSING}),
    "received E1 = 1.212e": (C1, {"E2": 0.0}),
    "positive moduli": (C1, {"G13": float("nan")}),
    "positive definite": (C1, {"nu12": 1.0}),
    "positive definite compliance": (C1, {"nu12": 0.9, "E1": 10e9}),
}


def constants(specimen: Specimen) -> dict[str, float]:
    return {name: float(value) for name, value in specimen.material.complete().items()}


def text_of(specimen: Specimen, element: Element = "brick", in_plane: int | None = 16) -> str:
    return plate_deck(specimen, constants(specimen), element, N_MODES, in_plane=in_plane).text


def data(text: str, card: str) -> str:
    return "".join(re.findall(rf"^\*{card}\b.*\n((?:[^*].*\n)+)", text, re.M))


def numbers(text: str, card: str) -> list[float]:
    return [float(v) for v in data(text, card).replace("\n", ",").split(",") if v.strip()]


def nodes_of(text: str) -> np.ndarray:
    rows = np.array(numbers(text, "NODE, NSET=ALL")).reshape(-1, 4)
    assert_array_equal(rows[:, 0], np.arange(1, len(rows) + 1))
    return rows[:, 1:]


def height_of_run(text: str, run: int) -> float:
    rows = np.array(numbers(text, f"ELEMENT, TYPE=C3D20R, ELSET=PLIES_{run}"), dtype=int).reshape(-1, 21)
    return float(np.ptp(nodes_of(text)[rows[:, 1:] - 1, 2]))


def test_each_run_of_plies_has_bricks_of_its_thickness_and_its_axes() -> None:
    text, ply = text_of(builtin("D2")), 3.2e-3 / 32  # [(0/90)_8]_s: the two 90s at the midplane form one run
    sections = re.findall(r"SOLID SECTION, ELSET=PLIES_(\d+), .*ORIENTATION=(\w+)", text)
    angles = []
    for _, name in sections:
        axes = numbers(text, f"ORIENTATION, NAME={name}")
        angles.append(np.rad2deg(np.arctan2(axes[1], axes[0])))
        assert_allclose(axes[3:5], [-axes[1], axes[0]], atol=1e-12)
    assert [int(run) for run, _ in sections] == list(range(1, 32))
    heights = [height_of_run(text, run) for run in range(1, 32)]
    assert_allclose(heights, [ply] * 15 + [2 * ply] + [ply] * 15, rtol=1e-9)
    assert_allclose(angles, [0, 90] * 7 + [0, 90, 0] + [90, 0] * 7, atol=1e-9)


@pytest.mark.parametrize(
    ("layup", "first"), [("[0]", 1.0), ("[0_20]", 1.0), ("[0/90]", 0.5), ("[30_3/-45]", 0.75)]
)
def test_few_runs_of_plies_still_have_four_layers_of_bricks(layup: str, first: float) -> None:
    text = text_of(with_plate("D2", layup=parse_layup(layup)))
    assert height_of_run(text, 1) == pytest.approx(first * 3.2e-3)
    z = np.unique(np.round(nodes_of(text)[:, 2], 12))
    assert len(z) == 2 * 4 + 1  # A layer has nodes on its two faces and in between.
    assert_allclose([z[0], z[-1]], [-1.6e-3, 1.6e-3])


def test_plies_are_transversely_isotropic() -> None:
    text = text_of(builtin("C1"))
    E1, E2, E3, nu12, nu13, nu23, G12, G13, G23 = numbers(text, "ELASTIC, TYPE=ENGINEERING CONSTANTS")
    assert (E1, E2, nu12, G12) == (121.2e9, 9.34e9, 0.23, 6.25e9)
    assert (E3, nu13, G13) == (E2, nu12, G12)
    assert_allclose(E2, 2 * G23 * (1 + nu23), rtol=1e-11)  # Isotropy across the fibres: E = 2 G (1 + nu).
    assert len(data(text, "ELASTIC").splitlines()[0].split(",")) == 8
    assert numbers(text, "DENSITY") == [1590.0]


@pytest.mark.parametrize("nu12", [0.04, 0.15])
def test_an_orthotropic_ply_is_positive_definite_in_three_dimensions(nu12: float) -> None:
    material = Material("orthotropic", {"E1": 0.9e9, "E2": 11e9, "nu12": nu12, "G12": 0.7e9}, {}, None)
    expected = [0.9e9, 11e9, 0.9e9, nu12, 0.0, 0.0, 0.7e9, 0.7e9, 0.7e9]  # impossible if nu13 = nu12
    assert numbers(text_of(replace(C1, material=material)), "ELASTIC") == expected


@pytest.mark.parametrize(
    ("edges", "of_bricks", "of_shells"),
    [
        ("CFFF", "X0, 1; X0, 2; X0, 3", "X0, 1; X0, 2; X0, 3; X0, 4; X0, 5"),
        # Simply supported: the displacement along the edge, and the rotation about the edge normal.
        ("SFFS", "X0, 2; X0, 3; Y1, 1; Y1, 3", "X0, 2; X0, 3; X0, 4; Y1, 1; Y1, 3; Y1, 5"),
    ],
)
def test_edges_hold_what_their_condition_says(edges: str, of_bricks: str, of_shells: str) -> None:
    for element, held in (("brick", of_bricks), ("shell", of_shells)):
        text = text_of(with_plate("D2", edges=edges), element)
        assert data(text, "BOUNDARY").splitlines() == [f"EDGE_{row}" for row in held.split("; ")]
    assert data(text_of(with_plate("D2", edges="FFFF")), "BOUNDARY") == ""


@pytest.mark.parametrize("element", ["shell", "brick"])
def test_lines_numbers_and_any_name_fit_what_both_programs_read(element: Element) -> None:
    specimen = with_plate("D2", layup=parse_layup("[12.345/-77.77/30]"), length=1 / 7)
    heading, *lines = data(text_of(specimen, element), r"\w+").splitlines()
    assert heading.startswith("Plate D2")
    for line in lines:
        fields = line.rstrip(",").split(",")
        assert len(fields) <= 16
        assert all(len(field.strip()) <= 20 for field in fields)  # CalculiX reads 20 characters of a number
        assert len(line) <= 132
    strange = replace(specimen, name="*STEP\n*plaque \N{GREEK SMALL LETTER ALPHA}")
    assert text_of(strange, element).splitlines()[1].startswith("Plate *STEP?*plaque ?, layup")


@pytest.mark.parametrize(("element", "z"), [("shell", 0.0), ("brick", 1.6e-3)])
def test_known_masses_sit_on_vertices_at_their_places(element: Element, z: float) -> None:
    places = [(0.0991, 0.0007), (0.1, 0.052), (0.0333, 0.0444)]
    sensors = tuple(Sensor(1e-3 * k, *place) for k, place in enumerate(places, start=1))
    specimen = replace(builtin("D2"), sensors=sensors)
    deck = plate_deck(specimen, constants(specimen), element, N_MODES, in_plane=32)
    last = deck.mesh.elements[..., 0].size
    for k, place in enumerate(places, start=1):
        number, node = numbers(deck.text, f"ELEMENT, TYPE=MASS, ELSET=SENSOR_{k}")
        assert_allclose(nodes_of(deck.text)[int(node) - 1], [*place, z], atol=1e-12)
        assert numbers(deck.text, f"MASS, ELSET=SENSOR_{k}") == [1e-3 * k]
        assert number == last + k


def test_grid_lines_narrow_towards_edges_and_meet_every_point() -> None:
    lines = grid_lines(1.0, 10, 0.01, ("C", "F"), [0.001, 0.5, 0.97, 0.5])
    assert np.all(np.diff(lines) > 0.0)
    assert (lines[0], lines[-1]) == (0.0, 1.0)
    assert_allclose(lines[:4], [0.0, 0.001, 0.005, 0.015])
    assert {0.5, 0.97} <= set(lines)


@pytest.mark.parametrize("said", NO_DECK)
def test_what_has_no_deck_is_refused(said: str) -> None:
    specimen, changes = NO_DECK[said]
    given = {k: v for k, v in {**constants(C1), **changes}.items() if v != MISSING}
    with pytest.raises(ValueError, match=said):
        plate_deck(specimen, given, "brick", N_MODES)
    with pytest.raises(ValueError, match="element: received 'tube', accepted: shell, brick"):
        plate_deck(C1, constants(C1), "tube", N_MODES)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="number of modes: received 0"):
        plate_deck(C1, constants(C1), "brick", 0)


# Typed by hand after the layout of CalculiX 2.20: a free plate with two deformation modes.
RESULTS = Path(__file__).with_name("results.dat").read_text("utf-8")


def test_eigenvalues_have_their_signs_and_displacements_the_order_of_the_nodes() -> None:
    assert_allclose(run.read_eigenvalues(RESULTS), [-0.15, 0.02, 394784.2, 1579137.0])
    for number in ("NaN", "**************"):
        with pytest.raises(CalculixError, match="no number for mode 3"):
            run.read_eigenvalues(RESULTS.replace("0.3947842E+06", number))
    found = run.read_displacements(RESULTS, np.array([7, 3]))
    assert_allclose(found[0], [[4.0, 0.5, 6.0], [1.0, 2.0, -3.0]])
    assert_allclose(found[1, :, 2], [-1.0, 1.0])
    with pytest.raises(CalculixError, match="no displacement of node 9"):
        run.read_displacements(RESULTS, np.array([9]))


@pytest.mark.parametrize(("eigenvalues", "n_rigid"), [ONE_TOO_MANY, ONE_TOO_FEW, *OTHERS])
def test_a_wrong_number_of_rigid_body_motions_is_an_error(eigenvalues: list[float], n_rigid: int) -> None:
    assert_array_equal(deformation_modes(np.array([5e5, -0.3, 4e5, 0.1]), 2), [2, 0])
    with pytest.raises(CalculixError, match=f"the edges leave {n_rigid} rigid-body motions"):
        deformation_modes(np.array(eigenvalues), n_rigid)


@pytest.fixture
def run_by(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Run a deck with a script in place of CalculiX."""

    def running(script: str, **options: float) -> str:
        path = tmp_path / "my ccx"
        path.write_text(f"#!/bin/sh\n{script}\n")
        path.chmod(0o755)
        monkeypatch.setenv(run.PROGRAM_VARIABLE, str(path))
        return run_deck("*HEADING\n", **options)

    return running


def test_frequencies_come_back_through_files(run_by, tmp_path: Path) -> None:
    (tmp_path / "results").write_text(RESULTS)
    assert run_by(f'test -f plate.inp && cp "{tmp_path / "results"}" plate.dat') == RESULTS


@pytest.mark.parametrize(
    ("script", "said"),
    [
        ("echo '*ERROR reading *NODE'; exit 201", r"status 201; (?s:.*)\*ERROR reading \*NODE"),
        ("kill -9 $$", "signal 9"),
        ("echo 'no step in this deck'", r"no eigenvalues; (?s:.*)no step in this deck"),
        ("exec sleep 60", r"within 0\.2 s"),
    ],
)
def test_a_run_that_fails_shows_why_and_the_last_lines_of_the_program(run_by, script: str, said: str) -> None:
    with pytest.raises(CalculixError, match=said):
        run_by(script, timeout=0.2 if "sleep" in script else 60.0)
