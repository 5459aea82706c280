"""A good plate file becomes records in SI."""

import pickle

import numpy as np
import pytest

from cpam_bayes.parameters import TruncatedNormal, Uniform
from cpam_bayes.plate import parse_specimen, read_specimen


@pytest.fixture
def specimen(plate_file, full_text):
    return read_specimen(plate_file(full_text))


def test_every_key_arrives_in_si(specimen):
    plate, material, measurement = specimen.plate, specimen.material, specimen.measurement
    assert (specimen.name, specimen.specimen) == ("plate 7", "seven")
    assert specimen.notes == ("cut from the edge",)
    assert (plate.length, plate.width, plate.thickness) == (0.26, 0.25, 0.0032)
    assert (plate.density, plate.mass, plate.edges) == (1590.0, None, "CFSF")
    assert plate.area == pytest.approx(0.065, rel=1e-15)
    assert plate.sd == {"thickness": 2e-5, "density": 15.0}
    assert plate.layup.text == "[(0/90)_8]_s"
    assert plate.mesh is None
    assert (material.name, material.isotropic) == ("carbon", False)
    assert set(material.constants) == {"E1", "E2", "nu12", "G12", "G23"}
    assert material.constants["E1"] == pytest.approx(121.2e9, rel=1e-15)
    assert material.sd == {"E1": 12e9, "nu12": 0.02}
    assert (specimen.angle_grid_deg, specimen.air_density) == (15.0, 1.2)
    assert [(s.mass, s.x, s.y) for s in specimen.sensors] == [(0.0012, 0.25, 0.24), (0.0005, 0, 0)]
    assert measurement.frequencies.tolist() == [102, 311, 342, 342, 390, 612.5]
    assert measurement.frequency_sd.tolist() == [0.2, 0.5, 0.5, 0.6, 0.6, 1.0]
    assert (measurement.resolution, measurement.relative_std) == (0.5, 0.005)
    assert measurement.labels == ("(1,1)", "", "", "", "", "")
    assert measurement.complete is False
    assert (measurement.missed_probability, measurement.false_peaks) == (0.1, 0.1)


def test_how_complete_a_list_is_can_be_said(full_text):
    said = full_text.replace(
        "complete = false", "complete = false\nmissed_probability = 0.3\nfalse_peaks = 0"
    )
    measurement = parse_specimen(said, "x").measurement
    assert (measurement.missed_probability, measurement.false_peaks) == (0.3, 0.0)


def test_unknowns_carry_priors_in_si(specimen):
    unknowns = specimen.unknowns
    assert unknowns.names == ("E1", "E2", "nu12", "G12")
    assert [p.unit for p in unknowns.parameters] == ["Pa", "Pa", "", "Pa"]
    assert unknowns["E1"].prior == Uniform(10e9, 200e9)
    assert unknowns["nu12"].prior == TruncatedNormal(0.28, 0.03, 0.15, 0.4)


def test_a_truncated_normal_modulus_is_scaled_in_every_number(full_text):
    spoilt = full_text.replace(
        "E1_GPa = [10.0, 200.0]", "E1_GPa = { mean = 120, sd = 10, bounds = [80, 160] }"
    )
    prior = parse_specimen(spoilt, "x").unknowns["E1"].prior
    assert prior == TruncatedNormal(120e9, 10e9, 80e9, 160e9)


def test_sequence_takes_the_layup_with_unknown_angles(plate_file, full_text):
    path = plate_file(full_text)
    assert read_specimen(path).with_unknown_angles().plate.layup.text == "[(?/?/?/?)_4]_s"
    path = plate_file(full_text.replace('sequence_layup = "[(?/?/?/?)_4]_s"\n', ""))
    assert read_specimen(path).with_unknown_angles().plate.layup.text == "[(0/90)_8]_s"


def test_what_may_be_left_out_may_be_left_out():
    text = """
    name = "least"
    [plate]
    length_mm = 100
    width_mm = 50
    thickness_mm = 2
    mass_g = 27
    edges = "FFFF"
    [material]
    isotropic = true
    E1_GPa = 69
    nu12 = 0.33
    """
    specimen = parse_specimen(text, "x")
    assert specimen.specimen == "least"
    assert specimen.measurement is None
    assert specimen.plate.mass == 0.027
    assert specimen.plate.density == pytest.approx(2700.0, rel=1e-14)
    assert specimen.plate.layup.angles_deg.tolist() == [0.0]
    assert specimen.unknowns.size == 0
    assert specimen.angle_grid_deg == 5.0
    assert specimen.air_density is None
    assert specimen.sensors == ()
    assert specimen.notes == ()


def test_a_list_of_frequencies_alone_is_a_measurement(full_text):
    head, _, _ = full_text.partition("[measurement]")
    measurement = parse_specimen(head + "[measurement]\nfrequencies_hz = [1, 2]\n", "x").measurement
    assert measurement.size == 2
    assert measurement.resolution == 0.0
    assert measurement.complete
    assert measurement.relative_std is None
    assert measurement.frequency_sd is None
    assert measurement.labels == ("", "")


def test_dotted_keys_and_inline_tables_say_the_same_as_tables(full_text):
    text = full_text.replace(
        "\n[plate.sd]\nthickness_mm = 0.02\ndensity_kg_m3 = 15\n",
        "sd = { thickness_mm = 0.02, density_kg_m3 = 15 }\n",
    ).replace("\n[environment]\n", "\n[environment]\n\n")
    assert parse_specimen(text, "x").plate.sd == {"thickness": 2e-5, "density": 15.0}
    assert (
        parse_specimen(
            "environment.air_density_kg_m3 = 1.1\n"
            + text.replace("[environment]\n\nair_density_kg_m3 = 1.2\n", ""),
            "x",
        ).air_density
        == 1.1
    )


def test_a_mesh_is_found_from_the_plate_file(tmp_path, plate_file, full_text):
    (tmp_path / "plate.msh").write_text("mesh")
    text = full_text.replace("[plate]\n", '[plate]\nmesh = "plate.msh"\n')
    assert read_specimen(plate_file(text)).plate.mesh == tmp_path / "plate.msh"


@pytest.mark.parametrize(
    "encode",
    [
        lambda text: ("\ufeff" + text).encode(),
        lambda text: text.replace("\n", "\r\n").encode(),
    ],
)
def test_files_written_on_windows_are_read(tmp_path, full_text, encode):
    path = tmp_path / "plate.toml"
    path.write_bytes(encode(full_text))
    assert read_specimen(str(path)).name == "plate 7"


def test_a_link_to_a_plate_file_is_a_plate_file(tmp_path, plate_file, full_text):
    link = tmp_path / "link.toml"
    link.symlink_to(plate_file(full_text))
    assert read_specimen(str(link)).name == "plate 7"


def test_records_are_read_only_and_travel_between_processes(specimen):
    with pytest.raises(ValueError, match="read-only"):
        specimen.measurement.frequencies[0] = 1.0
    with pytest.raises(AttributeError):
        specimen.plate.length = 1.0
    again = pickle.loads(pickle.dumps(specimen))
    assert again.unknowns == specimen.unknowns
    assert np.array_equal(again.measurement.frequencies, specimen.measurement.frequencies)


@pytest.mark.parametrize(
    ("said", "symmetry"),
    [
        ("", "transversely_isotropic"),
        ("isotropic = false\n", "transversely_isotropic"),
        ('symmetry = "transversely_isotropic"\n', "transversely_isotropic"),
        ('isotropic = false\nsymmetry = "orthotropic"\n', "orthotropic"),
        ('symmetry = "orthotropic"\n', "orthotropic"),
    ],
)
def test_constants_of_a_composite_are_transversely_isotropic_unless_said_otherwise(full_text, said, symmetry):
    material = parse_specimen(full_text.replace("isotropic = false\n", said), "x").material
    assert (material.symmetry, material.isotropic) == (symmetry, False)


@pytest.mark.parametrize(
    "constants",
    [
        "E1_GPa = 60\nE2_GPa = 60\nnu12 = 0.05\nG12_GPa = 4",  # balanced fabric
        "E1_GPa = 0.9\nE2_GPa = 11\nnu12 = 0.04\nG12_GPa = 0.8",  # wood, its grain along axis 2
        "E1_GPa = 11\nE2_GPa = 0.9\nnu12 = 0.51\nG12_GPa = 0.8",  # spruce
    ],
)
def test_orthotropic_moduli_come_in_any_order(full_text, constants):
    before, _, after = full_text.partition("[material]")
    _, _, after = after.partition("[unknowns]")
    after = after.replace("nu12 = {", "nu12 = [-1.5, 1.5] # {")
    text = f'{before}[material]\nsymmetry = "orthotropic"\n{constants}\n[unknowns]{after}'
    specimen = parse_specimen(text, "x")
    assert specimen.unknowns["nu12"].prior == Uniform(-1.5, 1.5)
    complete = specimen.material.complete()
    assert complete["G13"] == complete["G23"] == specimen.material.constants["G12"]
