"""The built-in specimens agree with the printed Tables 1 to 4 and the bounds of eq. (8)."""

import pytest

from cpam_bayes.parameters import Uniform
from cpam_bayes.plate import builtin, builtin_names, read_specimen, to_user, user_name
from cpam_bayes.printed.tables import PrintedRow, printed_table

SIX_ANGLES = {"F1": "C2", "F2": "C4", "G1": "D2", "G2": "D4"}
GLASS = {"C3", "C4", "D3", "D4", "F2", "G2"}
THICK = {"D1", "D2", "D3", "D4", "G1", "G2"}
CLAMPED = {"A2": 0.28, "D3": 0.06, "D4": 0.06, "G2": 0.06}  # the width, along the clamped edge
TABULATED = [name for name in builtin_names() if name != "D&G"]
SLIPS = {"C1": ["[(0/90)_8]_8"], "B1": ["40 plies"], "D1": ["1029", "3.6"], "C3": ["5 GPa"], "A2": ["28"]}


def numbers(row: PrintedRow) -> list[float]:
    return [cell.number for cell in row.values.values() if cell.number is not None]


def test_the_names_are_the_papers_and_another_one_is_refused_with_them():
    assert " ".join(builtin_names()) == "D&G A1 A2 B1 B2 C1 C2 C3 C4 D1 D2 D3 D4 F1 F2 G1 G2"
    with pytest.raises(ValueError, match=r"E9.*accepted.*C1"):
        builtin("E9")


@pytest.mark.parametrize("row", printed_table(2).rows, ids=lambda row: row.specimen)
def test_sizes_densities_and_layups_are_printed(row: PrintedRow) -> None:
    plate = builtin(row.specimen).plate
    length, width, thickness, density = numbers(row)[:4]
    sizes = (length, width) if row.specimen != "A2" else (width, length)  # A2 is clamped on its longer edge
    assert (plate.length, plate.width) == pytest.approx([size / 100 for size in sizes])
    assert (plate.thickness, plate.density) == pytest.approx((thickness / 100, 1000 * density))
    if "layup" in row.values:
        cell = row.values["layup"]
        assert (cell.text.lower() != plate.layup.text) is cell.misprinted("value")


@pytest.mark.parametrize(("number", "source"), [(1, "Experimental [9]"), (4, "modal test")])
def test_frequencies_are_printed(number: int, source: str) -> None:
    for row in printed_table(number).rows:
        if row.source == source:
            assert builtin(row.specimen).measurement.frequencies.tolist() == numbers(row)


@pytest.mark.parametrize("name", TABULATED)
def test_edges_constants_and_lists_are_those_of_the_plate(name):
    specimen, own = builtin(name), builtin(SIX_ANGLES.get(name, name))
    assert specimen.plate.edges == ("CFFF" if name in CLAMPED else "FFFF")
    assert specimen.plate.width == CLAMPED.get(name, specimen.plate.width)
    material, measurement = specimen.material, specimen.measurement
    composite = "glass/epoxy" if name in GLASS else "carbon/epoxy"
    assert material.name == ("aluminium" if name in ("A1", "A2") else composite)
    assert material.isotropic == (name in ("A1", "A2"))
    # G23 is printed for carbon, and four plates take it from eq. (6)
    (row,) = (row for row in printed_table(3).rows if row.specimen == material.name)
    printed = {key: cell.number for key, cell in row.values.items() if key != "G23_GPa"}
    constants = {user_name(key): to_user(key, value) for key, value in material.constants.items()}
    assert constants.pop("G23_GPa", None) == (3.0 if name in ("D1", "D2", "G1") else None)
    assert constants == pytest.approx({key: printed[key] for key in constants}, rel=1e-12)
    assert len(constants) == (2 if material.isotropic else 4)
    assert material.sd == pytest.approx({k: 0.1 * v for k, v in material.constants.items()}, rel=1e-14)
    assert (measurement.resolution, measurement.relative_std, measurement.complete) == (1.0, None, True)
    assert measurement.frequencies.tolist() == own.measurement.frequencies.tolist()


@pytest.mark.parametrize("name", builtin_names())
def test_bounds_are_those_of_eq_8_and_nothing_else_is_on_the_plate(name):
    specimen = builtin(name)
    bounds = {"E1": (10e9, 200e9), "nu12": (0.15, 0.4)}
    if name not in ("D&G", "A1", "A2"):
        bounds["E2"] = (5e9, 40e9)
        bounds["G12"] = (2e9 if name in GLASS else 5e9, 30e9)
    if name in THICK:
        bounds["G23"] = (2e9, 30e9)
    priors = {p.name: p.prior for p in specimen.unknowns.parameters}
    assert priors == {key: Uniform(*limits) for key, limits in bounds.items()}
    assert (specimen.air_density, specimen.sensors, specimen.plate.layup.n_unknown) == (None, (), 0)
    names = (name, SIX_ANGLES.get(name, name), f"built-in {name}")
    assert (specimen.name, specimen.specimen, specimen.source) == names
    assert specimen.angle_grid_deg == 5.0
    assert specimen.material.admissible({})


def test_the_aluminium_plate_of_table_1_is_as_printed():
    specimen = builtin("D&G")
    plate, material = specimen.plate, specimen.material
    assert (plate.length, plate.width, plate.thickness) == (0.254, 0.254, 0.00316)
    assert (plate.density, plate.edges, material.isotropic) == (2770.0, "FFFF", True)
    assert material.constants == {"E1": pytest.approx(72.4e9, rel=1e-15), "nu12": 0.33}
    assert material.sd == {"E1": pytest.approx(7.24e9, rel=1e-15), "nu12": 0.033}
    assert specimen.measurement.resolution == 0.1


@pytest.mark.parametrize("name", TABULATED[2:])
def test_sequence_takes_the_unknown_angles_of_table_9b(name):
    known = builtin(name).plate.layup
    layup = read_specimen(name).with_unknown_angles().plate.layup
    assert (layup.n_plies, layup.is_symmetric) == (known.n_plies, True)
    expected = 6 if name in SIX_ANGLES else 5 if name in ("B1", "B2", "D1") else 4
    assert layup.n_unknown == expected
    assert layup.unknown_index[:expected].tolist() == list(range(expected))
    if name in SIX_ANGLES:
        assert layup.unknown_index[6] == -1
        assert layup.angles_deg[6:-6].tolist() == known.angles_deg[6:-6].tolist()
    else:
        assert layup.unknown_index.min() == 0
    assert layup.angles(known.angles_deg[:expected]).tolist() == known.angles_deg.tolist()


@pytest.mark.parametrize(("name", "slips"), [*SLIPS.items(), ("D&G", ["28 GPa"])])
def test_slips_of_print_are_noted_beside_the_printed_value(name, slips):
    notes = "\n".join(builtin(name).notes)
    assert [slip for slip in slips if slip not in notes] == []
