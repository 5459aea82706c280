"""The built-in specimens carry the paper's Tables 1 to 4, typed here a second time."""

import pytest

from cpam_bayes.parameters import Uniform
from cpam_bayes.plate import builtin, builtin_names, read_specimen

# Table 2: length cm, width cm, thickness cm, density g/cm3, layup (the endings "_8" read as "_s")
TABLE_2 = {
    "A1": (30.00, 28.00, 0.30, 2.70, None),
    "A2": (28.00, 25.00, 0.30, 2.70, None),
    "B1": (28.15, 24.55, 0.20, 1.54, [0] * 20),
    "B2": (24.50, 15.30, 0.20, 1.54, [0] * 20),
    "C1": (26.00, 26.00, 0.32, 1.59, [0, 90] * 8 + [90, 0] * 8),
    "C2": (24.30, 15.30, 0.32, 1.59, [0, 90] * 8 + [90, 0] * 8),
    "D1": (10.10, 5.30, 0.35, 1.55, [0] * 20),
    "D2": (10.00, 5.20, 0.32, 1.59, [0, 90] * 8 + [90, 0] * 8),
    "C3": (20, 16, 0.20, 1.59, [0, 90] * 8 + [90, 0] * 8),
    "C4": (20, 16, 0.20, 1.59, [45, -45] * 8 + [-45, 45] * 8),
    "D3": (12, 6, 0.35, 1.59, [0, 90] * 8 + [90, 0] * 8),
    "D4": (12, 6, 0.35, 1.59, [45, -45] * 8 + [-45, 45] * 8),
}

# Table 3, GPa: E1 E2 nu12 G12 G23
TABLE_3 = {
    "aluminium": {"E1": 69, "nu12": 0.33},
    "glass/epoxy": {"E1": 40.1, "E2": 8.9, "nu12": 0.23, "G12": 4.23},
    "carbon/epoxy": {"E1": 121.2, "E2": 9.34, "nu12": 0.23, "G12": 6.25},
}

TABLE_4 = {
    "A1": "114 167 218 289 300 497",
    "A2": "39 91 237 261 337 545",
    "B1": "60 82 143 218 232 257",
    "B2": "111 202 290 310 370 555",
    "C1": "102 311 342 364 390 612",
    "C2": "183 370 535 870 944 1050",
    "D1": "1670 3480 3860 4400 5100 6300 8800 9900 10500 11000",
    "D2": "1240 2170 3310 5350 6880 7030 7530 8910 11340 11710",
    "C3": "188 385 555 594 669 1076",
    "C4": "261 279 573 635 682 1002",
    "D3": "154 471 968 1626 2025 2743 3439 4658 5394 5819",
    "D4": "136 654 833 1792 2112 2410 3968 4025 5175 5824",
}

SIX_ANGLES = {"F1": "C2", "F2": "C4", "G1": "D2", "G2": "D4"}
GLASS = {"C3", "C4", "D3", "D4", "F2", "G2"}
THICK = {"D1", "D2", "D3", "D4", "G1", "G2"}


def _table_name(name):
    return SIX_ANGLES.get(name, name)


def _material_name(name):
    if name in ("A1", "A2"):
        return "aluminium"
    return "glass/epoxy" if name in GLASS else "carbon/epoxy"


TABULATED = [name for name in builtin_names() if name != "D&G"]


def test_the_names_are_the_papers():
    names = "D&G A1 A2 B1 B2 C1 C2 C3 C4 D1 D2 D3 D4 F1 F2 G1 G2"
    assert " ".join(builtin_names()) == names


@pytest.mark.parametrize("name", TABULATED)
def test_dimensions_and_layups_are_those_of_table_2(name):
    plate = builtin(name).plate
    length, width, thickness, density, layup = TABLE_2[_table_name(name)]
    if name == "A2":  # clamped on the bigger edge, which is put at x = 0
        length, width = width, length
    printed = [length / 100, width / 100, thickness / 100, density * 1000]
    found = [plate.length, plate.width, plate.thickness, plate.density]
    assert found == pytest.approx(printed, rel=1e-14)
    assert plate.mass is None
    assert plate.sd == {}
    assert plate.mesh is None
    assert plate.layup.angles_deg.tolist() == (layup or [0])


@pytest.mark.parametrize("name", TABULATED)
def test_edges_are_free_but_for_the_clamped_plates(name):
    clamped = name in ("A2", "D3", "D4", "G2")
    plate = builtin(name).plate
    assert plate.edges == ("CFFF" if clamped else "FFFF")
    if clamped:
        assert plate.width == {"A2": 0.28}.get(name, 0.06)


@pytest.mark.parametrize("name", TABULATED)
def test_constants_are_those_of_table_3_known_to_a_tenth(name):
    material = builtin(name).material
    assert material.name == _material_name(name)
    assert material.isotropic == (name in ("A1", "A2"))
    expected = dict(TABLE_3[material.name])
    if name in ("D1", "D2", "G1"):
        expected["G23"] = 3.0
    expected = {key: v if key == "nu12" else v * 1e9 for key, v in expected.items()}
    assert material.constants == pytest.approx(expected, rel=1e-14)
    assert material.sd == pytest.approx({k: 0.1 * v for k, v in expected.items()}, rel=1e-14)


@pytest.mark.parametrize("name", TABULATED)
def test_frequencies_are_those_of_table_4(name):
    measurement = builtin(name).measurement
    assert measurement.frequencies.tolist() == [float(f) for f in TABLE_4[_table_name(name)].split()]
    assert measurement.resolution == 1.0
    assert measurement.relative_std is None
    assert measurement.frequency_sd is None
    assert measurement.complete


@pytest.mark.parametrize("name", builtin_names())
def test_bounds_are_those_of_eq_8(name):
    unknowns = builtin(name).unknowns
    bounds = {"E1": (10e9, 200e9), "nu12": (0.15, 0.4)}
    if name not in ("D&G", "A1", "A2"):
        bounds["E2"] = (5e9, 40e9)
        bounds["G12"] = (2e9 if name in GLASS else 5e9, 30e9)
    if name in THICK:
        bounds["G23"] = (2e9, 30e9)
    assert {p.name: p.prior for p in unknowns.parameters} == {
        key: Uniform(*limits) for key, limits in bounds.items()
    }


def test_the_aluminium_plate_of_table_1_is_as_printed():
    specimen = builtin("D&G")
    plate, material, measurement = specimen.plate, specimen.material, specimen.measurement
    assert (plate.length, plate.width, plate.thickness) == (0.254, 0.254, 0.00316)
    assert (plate.density, plate.edges) == (2770.0, "FFFF")
    assert material.isotropic
    assert material.constants == {"E1": pytest.approx(72.4e9, rel=1e-15), "nu12": 0.33}
    assert material.sd == {"E1": pytest.approx(7.24e9, rel=1e-15), "nu12": 0.033}
    assert measurement.frequencies.tolist() == [156.7, 232.5, 300.4, 411.7, 411.7, 744.9]
    assert measurement.resolution == 0.1


def test_plates_of_one_batch_share_a_material_name_with_equal_constants():
    shared = {}
    for name in builtin_names():
        material = builtin(name).material
        for constant, value in material.constants.items():
            assert shared.setdefault((material.name, constant), value) == value


@pytest.mark.parametrize("name", builtin_names())
def test_no_built_in_has_air_or_sensors_and_all_reference_constants_are_physical(name):
    specimen = builtin(name)
    assert specimen.air_density is None
    assert specimen.sensors == ()
    assert specimen.name == name
    assert specimen.source == f"built-in {name}"
    assert specimen.angle_grid_deg == 5.0
    assert specimen.material.admissible({})


@pytest.mark.parametrize("name", builtin_names())
def test_identify_takes_known_layups(name):
    assert builtin(name).plate.layup.n_unknown == 0


@pytest.mark.parametrize("name", TABULATED[2:])
def test_sequence_takes_the_unknown_angles_of_table_9b(name):
    known = builtin(name).plate.layup
    layup = read_specimen(name).with_unknown_angles().plate.layup
    assert layup.n_plies == known.n_plies
    assert layup.is_symmetric
    expected = 6 if name in SIX_ANGLES else 5 if name in ("B1", "B2", "D1") else 4
    assert layup.n_unknown == expected
    if name in SIX_ANGLES:
        assert layup.unknown_index[:7].tolist() == [0, 1, 2, 3, 4, 5, -1]
        assert layup.angles_deg[6:-6].tolist() == known.angles_deg[6:-6].tolist()
    else:
        assert layup.unknown_index[:expected].tolist() == list(range(expected))
        assert layup.unknown_index.min() == 0
    # the true angles give back the known layup
    true = known.angles_deg[:expected]
    assert layup.angles(true).tolist() == known.angles_deg.tolist()


@pytest.mark.parametrize(("name", "plate"), SIX_ANGLES.items())
def test_the_six_angle_cases_are_the_plates_they_name(name, plate):
    assert builtin(name).specimen == plate


@pytest.mark.parametrize(
    ("name", "slip"),
    [
        ("C1", "[(0/90)_8]_8"),
        ("C3", "[(0/90)_8]_8"),
        ("C4", "[(45/-45)_8]_8"),
        ("B1", "40 plies"),
        ("B2", "40 plies"),
        ("D1", "40 plies"),
        ("D1", "1029"),
        ("D1", "3.6"),
        ("D2", "3.6"),
        ("C3", "5 GPa"),
        ("D3", "5 GPa"),
        ("A2", "28"),
        ("D&G", "28 GPa"),
    ],
)
def test_slips_of_print_are_noted_beside_the_printed_value(name, slip):
    assert any(slip in note for note in builtin(name).notes)


def test_an_unknown_built_in_is_refused_with_the_names():
    with pytest.raises(ValueError, match=r"E9.*accepted.*C1"):
        builtin("E9")
