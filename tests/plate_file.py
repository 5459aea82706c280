"""Plate files of the tests: an aluminium plate with its list, a bar, any as a mapping; and a refusal."""

PLATE = """\
name = "plate 7"

[plate]
length_mm = 300.0
width_mm = 280.0
thickness_mm = 3.0
density_kg_m3 = 2700.0
edges = "FFFF"

[material]
isotropic = true
E1_GPa = 69.0
nu12 = 0.33

[unknowns]
E1_GPa = [10.0, 200.0]
nu12 = [0.15, 0.4]
"""
MEASURED = """
[measurement]
frequencies_hz = [114, 167, 218, 289, 300, 497]
resolution_hz = 1.0
"""
BAR = """\
name = "bar"
[plate]
length_mm = 200
width_mm = 100
thickness_mm = 3
density_kg_m3 = 2700
edges = "FFFF"
[material]
isotropic = true
E1_GPa = 69
nu12 = 0.33
"""
OF_TABLE = f"{BAR}[measurement]\n"
# Data sheet of a unidirectional carbon/epoxy, and the scatter between batches.
SHEET = {"E1_GPa": 132.0, "E2_GPa": 9.1, "nu12": 0.31, "G12_GPa": 4.8}
SHEET_SD = {"E1_GPa": 9.0, "E2_GPa": 0.6, "nu12": 0.02, "G12_GPa": 0.3}


def described(size_mm, density_kg_m3, material, *, layup="[0]", edges="FFFF", **tables):
    """A plate file as a mapping; tables : its other tables beside [plate] and [material]."""
    sizes = dict(zip(("length_mm", "width_mm", "thickness_mm"), size_mm, strict=True))
    plate = {**sizes, "density_kg_m3": density_kg_m3, "layup": layup, "edges": edges}
    return {"name": "plate", "plate": plate, "material": {**material}, **tables}


def refused(answer: tuple[object, str, str], *fragments: str) -> None:
    """Check that a command ended with status 2 and one message that contains these fragments."""
    status, out, err = answer
    assert (status, out, err.count("error: "), err.count("Traceback")) == (2, "", 1, 0)
    for fragment in fragments:
        assert fragment in err
