"""A page whose computations answer at once, for tests of the page itself."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from cpam_bayes.workbench.visit import Desk, Material, Tasks

EXAMPLE = (Path(__file__).parents[1] / "cpam_bayes" / "workbench" / "pages" / "example.toml").read_text(
    "utf-8"
)
ANSWER = {"constants": [], "rows": [], "rms": 0.2, "optimum": {}}
FOUND = {
    "claim": "A mass.",
    "kind": "named",
    "slips": [],
    "lines": [],
    "next": "",
    "constants": [],
    "causes": [],
    "rows": [],
    "nothing": 0.0,
    "place": [[262.0, 171.0], [3.0, 3.0]],
    "apply_said": "state it",
    "apply": {"sensor": {"mass_g": "5.10", "x_mm": "262", "y_mm": "171"}},
}
SETTLED = {
    **ANSWER,
    "headline": "Determined.",
    "slips": [],
    "lines": [],
    "next": "",
    "warnings": [],
    "shapes": [],
}


class Answers:
    """A worker that answers at once."""

    async def run(self, task: str, *args: Any, tell: Any = None) -> Any:
        if task == "report":
            page = Path(args[2]) / "report.html"
            page.write_text("<!doctype html><title>report</title>", "utf-8")
            return {"page": page.name, "folder": "."}
        return {"live": ANSWER, "identify": SETTLED, "diagnose": FOUND}[task]

    def stop(self) -> None:
        pass


class One:
    """A pool of one of them."""

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
    tasks = Tasks("live", "identify", "diagnose", "report")
    return Desk(folder, tasks, {"metal": material}, "name = 'plate'\n", EXAMPLE, Answers(), One(), rest=0.0)
