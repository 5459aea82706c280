"""Simulated aluminium plates for batches, quick to identify."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

import cpam_bayes as cb

SIZES = {"length_mm": 300.0, "width_mm": 260.0, "thickness_mm": 3.0, "density_kg_m3": 2700.0}
UNKNOWNS = {"E1_GPa": [40.0, 100.0], "nu12": [0.15, 0.45]}
N_MODES = 6


def plate(name: str, e1: float = 70.0, nu12: float = 0.33, **sizes: float) -> dict[str, Any]:
    """A plate with the exact list of these constants; its file states the reference, 69 GPa and 0.33."""
    described: dict[str, Any] = {
        "name": name,
        "plate": {**SIZES, **sizes, "edges": "FFFF"},
        "material": {"isotropic": True, "E1_GPa": 69.0, "nu12": 0.33, "name": "aluminium"},
        "unknowns": UNKNOWNS,
    }
    true = {**described, "material": {"isotropic": True, "E1_GPa": e1, "nu12": nu12}}
    f = cb.forward(true, N_MODES).frequencies
    return {**described, "measurement": {"frequencies_hz": f.tolist(), "relative_std": 0.002}}


def with_noise(described: Mapping[str, Any], rng: np.random.Generator, std: float = 0.002) -> dict[str, Any]:
    f = np.array(described["measurement"]["frequencies_hz"])
    noisy = (f * (1.0 + std * rng.standard_normal(len(f)))).tolist()
    return {**described, "measurement": {**described["measurement"], "frequencies_hz": noisy}}


def exact(described: Mapping[str, Any]) -> dict[str, Any]:
    return {**described, "plate": {**described["plate"], "sd": dict.fromkeys(SIZES, 0.0)}}


def written(path: Path, described: Mapping[str, Any]) -> Path:
    sizes = dict(described["plate"])
    tables = {**described, "plate.sd": sizes.pop("sd", {}), "plate": sizes}
    lines = [f'name = "{described["name"]}"']
    for section in ("plate", "plate.sd", "material", "unknowns", "measurement"):
        lines.append(f"[{section}]")
        lines += [f"{key} = {json.dumps(value)}" for key, value in tables[section].items()]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path
