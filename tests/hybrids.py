"""Hybrid plates for tests: carbon over glass, and sandwiches."""

from copy import deepcopy
from typing import Any

CARBON = {"E1_GPa": 121.2, "E2_GPa": 9.34, "nu12": 0.23, "G12_GPa": 6.25, "density_kg_m3": 1590.0}
GLASS = {"E1_GPa": 40.1, "E2_GPa": 8.9, "nu12": 0.23, "G12_GPa": 4.23, "density_kg_m3": 1900.0}

PLIES = {"layup": "[c0_2/g45/g-45/c90]_s", "edges": "FFFF"}
HYBRID: dict[str, Any] = {
    "name": "hybrid",
    "plate": {"length_mm": 300.0, "width_mm": 200.0, "thickness_mm": 3.0, **PLIES},
    "ply": [
        {"name": "c", "material": "carbon", "thickness_mm": 0.25},
        {"name": "g", "material": "glass", "thickness_mm": 0.375},
    ],
    "material": {"carbon": {**CARBON, "name": "carbon/epoxy"}, "glass": GLASS},
}

UNKNOWNS = {"carbon": {"E1_GPa": [80.0, 180.0], "E2_GPa": [5.0, 16.0]}, "glass": {"E1_GPa": [20.0, 60.0]}}


def hybrid(**plate: Any) -> dict[str, Any]:
    file = deepcopy(HYBRID)
    file["plate"] |= plate
    return file


def of_layers(layers, size_mm, edges="FFFF"):
    """A plate of layers at 0 deg, bottom to top: thickness in mm and table of the material."""
    names = [chr(ord("a") + i) for i in range(len(layers))]
    named = list(zip(names, layers, strict=True))
    sizes = {"length_mm": size_mm[0], "width_mm": size_mm[1], "thickness_mm": sum(t for t, _ in layers)}
    plate = {**sizes, "layup": f"[{'/'.join(names)}]", "edges": edges}
    plies = [{"name": name, "material": name, "thickness_mm": t} for name, (t, _) in named]
    materials = {name: material for name, (_, material) in named}
    return {"name": "layers", "plate": plate, "ply": plies, "material": materials}


def isotropic(E_GPa: float, density_kg_m3: float, nu: float = 0.3) -> dict[str, Any]:
    return {"symmetry": "isotropic", "E1_GPa": E_GPa, "nu12": nu, "density_kg_m3": density_kg_m3}


def sandwich(face_mm: float, core_GPa: float, edges: str = "FFFF") -> dict[str, Any]:
    """A plate of 240 x 180 x 10 mm with faces of 70 GPa and a core with this shear modulus."""
    face, core = isotropic(70.0, 2700.0), isotropic(2.6 * core_GPa, 100.0)
    return of_layers([(face_mm, face), (10.0 - 2.0 * face_mm, core), (face_mm, face)], (240.0, 180.0), edges)
