"""Build our models of a case in a separate process, which reports its time and memory.

python -m benchmarks.building CASE [--quick]
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.cases import CASES, Array, Case, parameters, reference_vector
from cpam_bayes.forward_model.build import reduced_model
from cpam_bayes.forward_model.model import PlateModel, training_sets
from cpam_bayes.forward_model.reduced import DEFAULT_SETTINGS, ReducedModel, ReductionSettings
from cpam_bayes.running import single_blas_thread

# Parameter sets that are solved together.
STACK = 64
_QUICK = ReductionSettings(training=16, checks=16, rounds=1)
_ROOT = Path(__file__).resolve().parent.parent


@dataclass(frozen=True, slots=True)
class Ours:
    """Our models of a case.

    x : (STACK, n_parameters), the reference plate and admissible sets from all over the prior box.
    seconds, peak_mib : cost of building them; the memory is ``None`` where the system does not report it.
    """

    case: Case
    reduced: ReducedModel
    x: Array
    seconds: float
    peak_mib: float | None

    @property
    def full(self) -> PlateModel:
        """The model that the reduced one was made from."""
        return self.reduced.full


def prepare(case: Case, quick: bool) -> Ours:
    """Build the models of a case in another process, to measure the cost, and then in this one."""
    built = _built_elsewhere(case, quick)
    reduced = _reduced(case, quick)
    drawn = training_sets(reduced.full.operator.problem, STACK - 1, np.random.default_rng(7))
    x = np.concatenate((reference_vector(case)[None], drawn))
    return Ours(case, reduced, x, built["seconds"], built["peak_mib"])


def _reduced(case: Case, quick: bool) -> ReducedModel:
    specimen = case.specimen()
    return reduced_model(
        specimen,
        parameters(specimen),
        case.n_modes,
        settings=_QUICK if quick else DEFAULT_SETTINGS,
    )


def _built_elsewhere(case: Case, quick: bool) -> dict[str, Any]:
    command = [sys.executable, "-m", "benchmarks.building", case.name]
    path = os.pathsep.join([str(_ROOT), *(p for p in sys.path if p)])
    done = subprocess.run(
        [*command, "--quick"] if quick else command,
        cwd=_ROOT,
        env={**os.environ, "PYTHONPATH": path},
        stdout=subprocess.PIPE,
        text=True,
        check=True,
    )
    found: dict[str, Any] = json.loads(done.stdout)
    return found


def _peak_memory() -> float | None:
    """Largest resident memory of this program so far, MiB, without what its parent once held."""
    status = Path("/proc/self/status")
    if not status.exists():
        return None
    line = next(line for line in status.read_text().splitlines() if line.startswith("VmHWM"))
    return int(line.split()[1]) / 1024


def main() -> None:
    """Build the models of one case and print their cost."""
    parser = argparse.ArgumentParser(description="Build the models of a case, print its time and memory.")
    parser.add_argument("case", choices=[case.name for case in CASES])
    parser.add_argument("--quick", action="store_true")
    given = parser.parse_args()
    case = next(c for c in CASES if c.name == given.case)
    start = time.perf_counter()
    single_blas_thread(_reduced)(case, given.quick)
    seconds = time.perf_counter() - start
    print(json.dumps({"seconds": seconds, "peak_mib": _peak_memory()}))


if __name__ == "__main__":
    main()
