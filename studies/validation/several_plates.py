"""One flaw, diagnosed from its list alone and with what else is measured.

A sister plate is of the same material, its constants scattered about common ones; nothing is wrong with it.
A further test is of the same plate: its flaw is in that test too. The lists are those of the independent
elements, the answers are scored as those of the claims benchmark.
"""

from __future__ import annotations

import tempfile
import time
import zlib
from collections.abc import Iterable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import cpam_bayes as cb
from cpam_bayes.diagnosis.answers.optima import averaged_draws, weighted_quantiles
from cpam_bayes.diagnosis.comparison import SCATTER
from cpam_bayes.diagnosis.evidence.weighing import Weighed
from cpam_bayes.effects import CATALOGUE
from validation.claims import scoring
from validation.independent import lists
from validation.independent.lists import NominalPlate, Truth
from validation.independent.true_plate import FLAWS, TruePlate

Record = dict[str, Any]

ALONE, SISTER = "alone", "one sister"
CLAMPED, LOADED = "clamped as well", "with a mass as well"
SETUPS = (ALONE, SISTER, CLAMPED, LOADED)
# A known mass over the plate's, and where it sits, over the sides.
_MASS_SHARE, _PLACE = 0.02, {"x": 0.05, "y": 0.05}


@dataclass(frozen=True, slots=True)
class Laboratory:
    """A plate with free edges, the signal to noise of a flaw in its list, and what else is measured.

    among : names of the causes that are weighed, all unless given
    """

    plate: NominalPlate
    ratio: float
    seed: int
    setups: tuple[str, ...] = SETUPS
    among: tuple[str, ...] = ()


def files(laboratory: Laboratory, cause: str, number: int) -> tuple[Truth, dict[str, str]]:
    """The truth of a plate with a flaw, and the plate files: its own as "alone", one a setup.

    Raises ``UnreachableError`` for a cause that cannot have the signal to noise.
    """
    rng = np.random.default_rng([laboratory.seed, zlib.crc32(cause.encode()), number])
    # the file has the name of the plate as its specimen's
    nominal = replace(laboratory.plate, specimen=laboratory.plate.name)
    text, truth = lists.single(nominal, cause, laboratory.ratio, rng)
    own = replace(nominal.plate, constants=truth.constants)
    flaws = {cause: (truth.sizes[cause], truth.aux.get(cause, {}))}
    common = {name: value / scatter(rng) for name, value in truth.constants.items()}
    sister = replace(nominal.plate, constants={name: v * scatter(rng) for name, v in common.items()})

    def further(name: str, changed: TruePlate, reference: TruePlate) -> str:
        test = replace(nominal, name=f"{nominal.name} {name}", plate=reference)
        return lists.listed(test, changed, "one", flaws, rng)[0]

    def clamped(plate: TruePlate) -> TruePlate:
        return replace(plate, edges="CFFF")

    def loaded(plate: TruePlate) -> TruePlate:
        return FLAWS["sensor_mass"].apply(plate, _MASS_SHARE, _PLACE)

    other = replace(nominal, name=f"{nominal.name} sister", specimen=f"{nominal.name} sister")
    return truth, {
        ALONE: text,
        SISTER: lists.listed(other, sister, "clean", {}, rng)[0],
        CLAMPED: further("clamped", clamped(own), clamped(nominal.plate)),
        LOADED: further("loaded", loaded(own), loaded(nominal.plate)),
    }


def scatter(rng: np.random.Generator) -> float:
    """The factor of a constant from plate to plate of one material."""
    return float(1.0 + SCATTER * rng.standard_normal())


def trial(laboratory: Laboratory, item: tuple[str, int]) -> Record:
    """One flaw, diagnosed in every setup; "unreachable" says why there is none."""
    cause, number = item
    head: Record = {"cause": cause, "number": number}
    try:
        truth, texts = files(laboratory, cause, number)
    except lists.UnreachableError as error:
        return head | {"unreachable": str(error)}
    answers = {}
    with tempfile.TemporaryDirectory() as folder:
        paths = {setup: Path(folder) / f"{setup.replace(' ', '_')}.toml" for setup in texts}
        for setup, path in paths.items():
            path.write_text(texts[setup], "utf-8")
        for setup in laboratory.setups:
            plates = dict.fromkeys((paths[ALONE], paths[setup]))
            answers[setup] = answer(asdict(truth), truth.plate, list(plates), laboratory.among)
    return head | {"truth": asdict(truth), "setups": answers}


def answer(truth: Record, specimen: str, plates: list[Path], among: tuple[str, ...] = ()) -> Record:
    """The score of a diagnosis of these files, the true cause's probability, and the constants' spread."""
    start = time.process_time()
    catalogue = tuple(effect for effect in CATALOGUE if not among or effect.name in among)
    result = cb.diagnose(*map(str, plates), next_test="never", catalogue=catalogue)
    seconds = time.process_time() - start
    names = {*truth["causes"], *truth["accepted"]}
    constants = constants_of(result.diagnosis.weighed, specimen, truth["constants"])
    given = {"claim": result.claim, "causes": result.causes, "probability": result.probability}
    return {
        **scoring.score(truth, {**given, "constants": constants, "baseline": {}}),
        "cause_probability": sum(c.probability for c in result.diagnosis.causes if c.name in names),
        "relative_sd": {name: c["sd"] / abs(c["mean"]) for name, c in constants.items()},
        "seconds": round(seconds, 2),
    }


def constants_of(weighed: Weighed, specimen: str, constants: Iterable[str]) -> dict[str, dict[str, float]]:
    """The constants of a plate over all hypotheses, in the units of files, by their names there."""
    names, draws, weight = averaged_draws(weighed)
    found = {}
    for name in constants:
        x = draws[:, names.index(name)]
        deviation = f"scatter of {name}, {specimen}"
        if deviation in names:
            x = x * (1.0 + draws[:, names.index(deviation)])
        shown, unit = lists.IN_FILE[name]
        mean = float(weight @ x)
        sd = float(np.sqrt(weight @ (x - mean) ** 2))
        low, high = weighted_quantiles(x, weight, np.array([0.025, 0.975]))
        found[shown] = {
            key: float(value) / unit
            for key, value in (("mean", mean), ("sd", sd), ("q025", low), ("q975", high))
        }
    return found


def spread(answers: list[Record], alone: list[Record]) -> float:
    """Geometric mean of the constants' standard deviations over those of the lists alone."""
    ratios: list[NDArray[np.float64]] = [
        np.log([a["relative_sd"][name] / b["relative_sd"][name] for name in b["relative_sd"]])
        for a, b in zip(answers, alone, strict=True)
    ]
    return float(np.exp(np.mean(ratios)))
