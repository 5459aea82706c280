"""A small answer of every command, computed once per run for all tests of screens, figures and pages."""

import os
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import cpam_bayes as cb
from cpam_bayes.inference.ensemble import EnsembleSettings
from cpam_bayes.inference.swarm import SwarmSettings
from cpam_bayes.questions.diagnose import diagnosis_result
from cpam_bayes.questions.sequence import stacking_result
from cpam_bayes.result import Result
from tests.diagnosed import clean, misread
from tests.shared import DIRECTORY, once_a_run
from tests.stacking.cases import answer, mixture

CHAINS = EnsembleSettings(walkers=16, round_steps=300, effective=100.0, most_steps=600)
SWARM = SwarmSettings(particles=20, iterations=30)
SMALL: dict[str, Any] = {"settings": SWARM, "chains": CHAINS}
LIST = "frequencies_hz = [113.0, 166.0, 216.0, 287.0, 298.0, 494.0]\n"


def proved(folder: Path) -> Result:
    (folder / "with.toml").write_text(LIST, encoding="utf-8")
    return cb.prove("A1", folder / "with.toml")


def poles(folder: Path) -> Result:
    """Result of `poles` for a table of the accelerance of one mode at 120 Hz."""
    f = np.arange(50.0, 200.0, 0.5)
    h = -((f / 120.0) ** 2) / (1.0 - (f / 120.0) ** 2 + 0.02j * f / 120.0)
    h = h + 1e-3 * np.random.default_rng(0).standard_normal((2, f.size)).T @ [1.0, 1.0j]
    rows = [f"{x},{y.real:.8g},{y.imag:.8g}\n" for x, y in zip(f, h, strict=True)]
    (folder / "tap.csv").write_text("".join(["hz,real,imag\n", *rows]), encoding="utf-8")
    return cb.poles(folder / "tap.csv")


QUICK: dict[str, Callable[[Path], Result]] = {
    "batch": lambda folder: cb.batch("A1", "no such plate", limits=["E1_GPa >= 60"]),
    "compare": lambda folder: cb.compare("A1", "A2"),
    "diagnose": lambda folder: diagnosis_result(clean(), 0),
    "diagnose, named": lambda folder: diagnosis_result(misread(), 0),
    "export": lambda folder: cb.export("A1", folder / "A1.inp"),
    "forward": lambda folder: cb.forward("D1", 3),
    "identify": lambda folder: cb.identify("A1", seed=1),
    "new": lambda folder: cb.new(folder / "plate.toml"),
    "paper": lambda folder: table_7()[0],
    "plates": lambda folder: cb.plates(),
    "poles": poles,
}
SLOW: dict[str, Callable[[Path], Result]] = {
    "calibrate": lambda folder: cb.calibrate("A1", 20),
    "design": lambda folder: cb.design("A1"),
    "identify, emcee": lambda folder: cb.sample("A1", settings=CHAINS),
    "predict": lambda folder: cb.predict(answered("identify, emcee"), "A2"),
    "prove": proved,
    "report": lambda folder: cb.report("A1", quick=True),
    "sensitivity": lambda folder: cb.sensitivity("A1", levels=(0.01,), groups=3, **SMALL),
    "sequence": lambda folder: stacking_result(answer(), mixture(), None, 0, 5),
}
MARKS = dict.fromkeys(SLOW, (pytest.mark.slow,)) | {"calibrate": (pytest.mark.slow, pytest.mark.weekly)}
EVERY = [*QUICK, *(pytest.param(name, marks=MARKS[name]) for name in SLOW)]


@once_a_run
def answered(name: str) -> Result:
    """The answer of a command, or of its variant named after a comma."""
    return {**QUICK, **SLOW}[name](new_folder())


@once_a_run
def table_7() -> tuple[Result, Path]:
    """Table 7 of the paper computed with the small effort, and its store."""
    store = new_folder()
    return cb.paper(7, quick=True, store=store), store


def new_folder() -> Path:
    return Path(tempfile.mkdtemp(dir=os.environ[DIRECTORY]))
