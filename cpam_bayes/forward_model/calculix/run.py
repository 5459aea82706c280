"""CalculiX as a program: a deck goes in as a file, its results are read back from one."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.forward_model.calculix.results import CalculixError, deformation_modes, read_eigenvalues
from cpam_bayes.storage import draft_directory

PROGRAM_VARIABLE: Final = "CPAM_BAYES_CCX"
_PROGRAM: Final = "ccx"
_JOB: Final = "plate"
_SHOWN_LINES: Final = 12


def run_calculix(deck: Path, n_rigid: int, *, timeout: float | None = None) -> NDArray[np.float64]:
    """Natural frequencies that CalculiX finds for a deck file, ascending, Hz.

    n_rigid : rigid-body motions that the edges leave (`problem.rigid_body_count`); they are taken off.
    timeout : s.

    Raises CalculixError as `run_deck` does, and for another number of them.
    """
    results = run_deck(deck.read_text(encoding="utf-8", errors="replace"), timeout=timeout)
    eigenvalues = read_eigenvalues(results)
    places = deformation_modes(eigenvalues, n_rigid)
    return np.asarray(np.sqrt(eigenvalues[places]) / (2 * np.pi))


def run_deck(text: str, *, timeout: float | None = None) -> str:
    """The results (.dat) of CalculiX for the text of a deck, run in a temporary directory.

    The program is ``ccx``, or what the environment variable CPAM_BAYES_CCX names. It runs on one thread
    unless OMP_NUM_THREADS says otherwise.

    timeout : s.

    Raises CalculixError when the program is missing, fails, runs out of time or solves nothing.
    """
    program = _program()
    with draft_directory() as folder:
        Path(folder, f"{_JOB}.inp").write_text(text, encoding="utf-8", newline="\n")
        output = _execute(program, folder, timeout)
        file = Path(folder, f"{_JOB}.dat")
        results = file.read_text(encoding="ascii", errors="replace") if file.exists() else ""
    if read_eigenvalues(results).size == 0:
        raise CalculixError(f"CalculiX wrote no eigenvalues; its last lines:\n{_last(output)}")
    return results


def _program() -> str:
    named = os.environ.get(PROGRAM_VARIABLE)
    program = shutil.which(named or _PROGRAM)
    if program is None and named:
        raise CalculixError(
            f"{PROGRAM_VARIABLE}: received {named!r}, accepted: the path of CalculiX's program ccx"
        )
    if program is None:
        raise CalculixError(
            "the program ccx (CalculiX) is not installed: Debian's package is calculix-ccx; "
            f"a program in another place is named by the environment variable {PROGRAM_VARIABLE}"
        )
    return program


def _execute(program: str, folder: Path, timeout: float | None) -> str:
    """Run the program in a folder; its output."""
    environment = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", **os.environ}
    try:
        done = subprocess.run(
            [str(Path(program).absolute()), "-i", _JOB],
            cwd=folder,
            env=environment,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            timeout=timeout,
            check=False,
            encoding="utf-8",
            errors="replace",
        )
    except subprocess.TimeoutExpired as error:
        raise CalculixError(f"CalculiX did not finish within {timeout:g} s") from error
    except OSError as error:
        raise CalculixError(f"CalculiX could not be started: {error}") from error
    if done.returncode != 0:
        how = f"status {done.returncode}" if done.returncode > 0 else f"signal {-done.returncode}"
        raise CalculixError(f"CalculiX ended with {how}; its last lines:\n{_last(done.stdout)}")
    return done.stdout


def _last(output: str) -> str:
    lines = [line.rstrip() for line in output.splitlines() if line.strip()]
    return "\n".join(lines[-_SHOWN_LINES:])
