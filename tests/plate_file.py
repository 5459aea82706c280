"""The plate file of the tests of commands: an aluminium plate, and the list measured on it."""

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
