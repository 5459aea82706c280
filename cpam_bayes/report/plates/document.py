"""The JSON document of `plates`."""

from __future__ import annotations

from typing import Any

from cpam_bayes import __version__
from cpam_bayes.forward_model.builtin import BuiltinPlates
from cpam_bayes.plate import to_user, user_name
from cpam_bayes.report.plates.head import thickness_class


def document(result: BuiltinPlates) -> dict[str, Any]:
    """The JSON document of `plates`."""
    return {
        "command": "plates",
        "version": __version__,
        "plates": [
            {
                "name": s.name,
                "specimen": s.specimen,
                "length_mm": to_user("length", s.plate.length),
                "width_mm": to_user("width", s.plate.width),
                "thickness_mm": to_user("thickness", s.plate.thickness),
                "density_kg_m3": s.plate.density,
                "layup": s.plate.layup.text,
                "edges": s.plate.edges,
                "material": s.material.name,
                "isotropic": s.material.isotropic,
                "symmetry": s.material.symmetry,
                "unknowns": [user_name(name) for name in s.unknowns.names],
                "frequencies": 0 if s.measurement is None else s.measurement.size,
                "thickness_class": thickness_class(s.plate),
                "notes": list(s.notes),
            }
            for s in result.specimens
        ],
    }
