"""The built-in specimens beside what tests/printed compares with Tables 1 to 4."""

import pytest

from cpam_bayes.parameters import Uniform
from cpam_bayes.plate import builtin, builtin_names, read_specimen

SIX_ANGLES = {"F1": "C2", "F2": "C4", "G1": "D2", "G2": "D4"}
GLASS = {"C3", "C4", "D3", "D4", "F2", "G2"}
THICK = {"D1", "D2", "D3", "D4", "G1", "G2"}


TABULATED = [name for name in builtin_names() if name != "D&G"]


def test_the_names_are_the_papers_and_another_one_is_refused_with_them():
    names = "D&G A1 A2 B1 B2 C1 C2 C3 C4 D1 D2 D3 D4 F1 F2 G1 G2"
    assert " ".join(builtin_names()) == names
    with pytest.raises(ValueError, match=r"E9.*accepted.*C1"):
        builtin("E9")


@pytest.mark.parametrize("name", TABULATED)
def test_edges_are_free_but_for_the_clamped_plates(name):
    clamped = name in ("A2", "D3", "D4", "G2")
    plate = builtin(name).plate
    assert plate.edges == ("CFFF" if clamped else "FFFF")
    if clamped:
        assert plate.width == {"A2": 0.28}.get(name, 0.06)


@pytest.mark.parametrize("name", TABULATED)
def test_constants_are_of_the_material_of_table_3_and_known_to_a_tenth(name):
    material = builtin(name).material
    composite = "glass/epoxy" if name in GLASS else "carbon/epoxy"
    assert material.name == ("aluminium" if name in ("A1", "A2") else composite)
    assert material.isotropic == (name in ("A1", "A2"))
    assert material.constants.get("G23") == (3e9 if name in ("D1", "D2", "G1") else None)
    assert material.sd == pytest.approx({k: 0.1 * v for k, v in material.constants.items()}, rel=1e-14)
    # plates of one material have its constants, but for G23, which four leave to eq. (6)
    first = next(builtin(n).material for n in TABULATED if builtin(n).material.name == material.name)
    shared = first.constants.keys() & material.constants.keys()
    assert {k: first.constants[k] for k in shared} == {k: material.constants[k] for k in shared}


@pytest.mark.parametrize("name", TABULATED)
def test_lists_are_complete_rounded_to_1_hz_and_of_the_plate_they_are_named_after(name):
    measurement, own = builtin(name).measurement, builtin(SIX_ANGLES.get(name, name)).measurement
    assert (measurement.resolution, measurement.relative_std, measurement.complete) == (1.0, None, True)
    assert measurement.frequencies.tolist() == own.frequencies.tolist()


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
    assert (plate.density, plate.edges, material.isotropic) == (2770.0, "FFFF", True)
    assert material.constants == {"E1": pytest.approx(72.4e9, rel=1e-15), "nu12": 0.33}
    assert material.sd == {"E1": pytest.approx(7.24e9, rel=1e-15), "nu12": 0.033}
    assert measurement.frequencies.tolist() == [156.7, 232.5, 300.4, 411.7, 411.7, 744.9]
    assert measurement.resolution == 0.1


@pytest.mark.parametrize("name", builtin_names())
def test_no_built_in_has_air_or_sensors_and_all_reference_constants_are_physical(name):
    specimen = builtin(name)
    assert specimen.air_density is None
    assert specimen.sensors == ()
    assert specimen.plate.layup.n_unknown == 0
    assert specimen.name == name
    assert specimen.specimen == SIX_ANGLES.get(name, name)
    assert specimen.source == f"built-in {name}"
    assert specimen.angle_grid_deg == 5.0
    assert specimen.material.admissible({})


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


@pytest.mark.parametrize(
    ("name", "slip"),
    [
        ("C1", "[(0/90)_8]_8"),
        ("B1", "40 plies"),
        ("D1", "1029"),
        ("D1", "3.6"),
        ("C3", "5 GPa"),
        ("A2", "28"),
        ("D&G", "28 GPa"),
    ],
)
def test_slips_of_print_are_noted_beside_the_printed_value(name, slip):
    assert any(slip in note for note in builtin(name).notes)
