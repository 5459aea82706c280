"""A page whose computations answer at once, for tests of the page itself."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from cpam_bayes.workbench.visit import Desk, Material, Tasks

PAGES = Path(__file__).parents[1] / "cpam_bayes" / "workbench" / "pages"
EXAMPLE = (PAGES / "example.toml").read_text("utf-8")
ANSWER = {"constants": [], "rows": [], "rms": 0.2, "optimum": {}}
LINES: dict[str, Any] = {"slips": [], "lines": [], "next": ""}
FOUND = {
    "claim": "A mass.", "kind": "named", "constants": [], "causes": [], "rows": [], "nothing": 0.0, **LINES,
    "place": [[262.0, 171.0], [3.0, 3.0]], "apply_said": "state it",
    "apply": {"sensor": {"mass_g": "5.10", "x_mm": "262", "y_mm": "171"}},
}  # fmt: skip
SETTLED = {**ANSWER, **LINES, "headline": "Determined.", "warnings": [], "shapes": [], "all_rows": None}
HELD = {
    "said": "Hold it on four soft pads.", "pads_mm": [[100.0, 60.0]], "hits_mm": [[10.0, 10.0]],
    "sensor_mm": [10.0, 200.0], "modes": [],
}  # fmt: skip
SPECTRUM = [[50.0 + 10.0 * i, -20.0 if i % 10 else 0.0] for i in range(100)]
PICKED = {"modes": [76.4, 144.4, 212.6], "spectrum": SPECTRUM, "said": []}


class Answers:
    async def run(self, task: str, *args: Any, tell: Any = None) -> Any:
        if task == "report":
            page = Path(args[2]) / "report.html"
            page.write_text("<!doctype html><title>report</title>", "utf-8")
            (page.parent / "report.json").write_text("{}", "utf-8")
            (page.parent / "report.xlsx").write_bytes(b"PK")
            return {"page": page.name, "json": "report.json", "xlsx": "report.xlsx"}
        if task == "pick":
            return {"recording": args[3], **PICKED}
        if task == "batch":
            rows = [{"file": name, "cells": ["panel", "136.6"], "why": ""} for name in args[0].split("\n")]
            heads = [["plate", False], ["E1, GPa", True]]
            return {"headline": "1 plate.", "heads": heads, "rows": rows, "lines": [], "page": "report.html"}
        return {"live": ANSWER, "hold": HELD, "identify": SETTLED, "diagnose": FOUND}[task]

    def stop(self) -> None:
        pass


class One:
    def worker(self) -> One:
        return self

    async def __aenter__(self) -> Answers:
        return Answers()

    async def __aexit__(self, *error: object) -> None:
        pass

    def stop(self) -> None:
        pass


def desk_of(folder: Path) -> Desk:
    material = Material("aluminium", ('name = "aluminium"', "E1_GPa = 69.0"), ("E1_GPa = [20.0, 250.0]",))
    tasks = Tasks("live", "hold", "identify", "diagnose", "pick", "report", "batch")
    return Desk(folder, tasks, {"metal": material}, "name = 'plate'\n", EXAMPLE, Answers(), One(), rest=0.0)


def echo(value: Any, *, tell: Any) -> tuple[Any, int]:
    del tell
    return value, os.getpid()
