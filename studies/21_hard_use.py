"""What happens to hostile plate files, layups, tables, universal files, records, arguments and signals?

python studies/21_hard_use.py [--quick] [--minutes M] [--inputs N]

Hypothesis makes texts and files of each kind (studies/validation/hostile), and nine times as many are spliced
from pieces of those, which is quicker. Stored files are damaged byte by byte, functions get arguments of
wrong types, and running commands get signals. An input may be accepted or refused with a message; anything
else, including a warning of another library on the screen, is a failure. Each open-ended kind gets an equal
share of the time left by those before it.
"""

from __future__ import annotations

import contextlib
import inspect
import logging
import os
import resource
import signal
import subprocess
import sys
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, TypeVar

import numpy as np
from hypothesis import HealthCheck, Phase, given, seed, settings
from hypothesis import strategies as st

import cpam_bayes as cb
from cpam_bayes.errors import ArgumentError, LayupError, PlateFileError
from cpam_bayes.plate import parse_specimen
from cpam_bayes.plate.instruments import MAX_UNIVERSAL_BYTES, UniversalFileError, read_shapes
from cpam_bayes.plate.layup import parse_layup
from cpam_bayes.plate.modal_analysis.hits import ModalTestError
from cpam_bayes.plate.modes_of_hits import modes_of
from cpam_bayes.plate.modes_table import read_modes_table
from cpam_bayes.render.report import Heading, Table
from cpam_bayes.render.terminal import screen_text
from cpam_bayes.storage import read_arrays, write_arrays
from validation.hostile.files import DAMAGES, LARGE_FILES, crossed, layups, plate_texts
from validation.hostile.measurements import (
    LARGE_TABLES,
    LARGE_UNIVERSAL_FILES,
    mode_tables,
    recordings,
    response_tables,
    universal_modes_files,
    universal_response_files,
)
from validation.reporting import (
    counted,
    listed,
    paragraph,
    save_results,
    study_parser,
    write_sections,
)

Results = dict[str, Any]
Content = TypeVar("Content", str, bytes)

HERE = Path(__file__).parent
RESULTS = HERE / "results" / f"{Path(__file__).stem}.json"

KEYS = {
    "quick": "whether this is the small version",
    "kinds": "one for each kind of input: inputs, accepted, refused, failed, seconds of the slowest",
    "failures": "the first inputs of each kind that were neither accepted nor refused, with the exception",
    "memory_gib": "most memory that the process of the study held, GiB",
    "signals": "one for each command and signal: statuses, files left, files left after the next command",
}

SEED = 0
INPUTS = 100_000
# Inputs that hypothesis makes from one seed, and number of inputs spliced from pieces for each of them.
BATCH, CROSSED = 1000, 9
# Length and width of the plate on which modes of universal files are placed, m.
SIDES = (0.2, 0.1)
SHOWN_FAILURES = 5
SIGNALS = ("SIGINT", "SIGTERM", "SIGHUP", "SIGKILL")
# Commands that take long and write into a directory, each with what its progress says while it computes.
LONG = {
    "identify": ("rms misfit", "identify", "A1", "--particles", "10000", "--swarms", "1"),
    "identify, emcee": ("starting the ensembles", "identify", "C1", "--backend", "emcee"),
    "diagnose": ("of 23 models", "diagnose", "A1"),
    "sequence": ("log evidence", "sequence", "B1"),
    "sensitivity": ("noisy lists", "sensitivity", "A1"),
    "report": ("of 23 models", "report", "A1"),
    "paper": ("paper: 30 computations", "paper", "--quick"),
    "batch": ("1 of 2 plates", "batch", "C1", "C3"),
    "design": (" of 48 specimens", "design", "C1"),
}
WRONG = (object(), 1j, b"C1", [], {}, "?", -1, float("nan"), print, ...)


class Tally:
    """Outcomes of the inputs of one kind."""

    def __init__(
        self,
        kind: str,
        refusals: type[Exception] | tuple[type[Exception], ...],
        most: int,
        seconds: float,
    ) -> None:
        self.kind, self._refusals, self._most = kind, refusals, most
        self._end = time.monotonic() + seconds
        self.inputs = self.accepted = self.refused = 0
        self.slowest = 0.0
        self.failures: list[Results] = []

    @property
    def is_open(self) -> bool:
        """Whether time and number allow another input."""
        return self.inputs < self._most and time.monotonic() < self._end

    def record(self, shown: object, answer: Callable[[], object]) -> None:
        """Try one input; ``answer`` returns a false value if it was refused without an exception."""
        if not self.is_open:
            return
        self.inputs += 1
        start = time.process_time()
        try:
            accepted = bool(answer())
        except self._refusals:
            accepted = False
        except Exception as error:  # noqa: BLE001 - any exception is a failure to report
            self.failures.append(
                {
                    "kind": self.kind,
                    "input": repr(shown)[:500],
                    "error": f"{type(error).__name__}: {error}"[:500],
                }
            )
            return
        finally:
            self.slowest = max(self.slowest, time.process_time() - start)
        self.accepted += accepted
        self.refused += not accepted

    def row(self) -> Results:
        """The counts, ready for JSON."""
        return {
            "kind": self.kind,
            "inputs": self.inputs,
            "accepted": self.accepted,
            "refused": self.refused,
            "failed": len(self.failures),
            "slowest_seconds": round(self.slowest, 3),
        }


def run(quick: bool, inputs: int = INPUTS, minutes: float = 10.0) -> Results:
    """Results for all kinds of input, then all signals."""
    most, seconds = (20, 40.0) if quick else (inputs, 60.0 * minutes)
    warnings.simplefilter("error")
    end = time.monotonic() + seconds
    kinds = _kinds(most)
    tallies = []
    for left, kind in zip(range(len(kinds), 0, -1), kinds, strict=True):
        tallies.append(kind(max(0.0, end - time.monotonic()) / left))
        print(tallies[-1].row(), *tallies[-1].failures[:SHOWN_FAILURES], file=sys.stderr, flush=True)
    tallies[-1:-1] = [_large_files(), _large_universal_files()]
    return {
        "quick": quick,
        "kinds": [tally.row() for tally in tallies],
        "failures": [failure for tally in tallies for failure in tally.failures[:SHOWN_FAILURES]],
        "memory_gib": round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20, 3),
        "signals": [
            _signalled(command, name)
            for command in (("identify",) if quick else LONG)
            for name in (SIGNALS[1:2] if quick else SIGNALS)
        ],
    }


def _kinds(most: int) -> list[Callable[[float], Tally]]:
    """Functions that test one kind each for a given time in seconds; the quick kinds first."""
    made = _made_by_hypothesis
    return [
        partial(_wrong_arguments, most),
        partial(made, "layups", layups(), parse_layup, LayupError, most),
        partial(made, "tables of modes", mode_tables(), _read_table, (), most),
        partial(
            made, "universal files of modes", universal_modes_files(), _read_shapes, UniversalFileError, most
        ),
        partial(_damaged_files, most),
        partial(
            made,
            "universal files of responses",
            universal_response_files(),
            _poles_of(".unv"),
            ModalTestError,
            most,
        ),
        partial(made, "tables of responses", response_tables(), _poles_of(".csv"), ModalTestError, most),
        partial(made, "recorded hits", recordings(), _poles_of(".wav"), ModalTestError, most),
        partial(made, "plate files", plate_texts(), _read, PlateFileError, most),
    ]


def _read_shapes(content: bytes) -> object:
    return read_shapes(content, *SIDES)


def _poles_of(ending: str) -> Callable[[str | bytes], object]:
    """Function that gives the result of `cb.poles` for the content of a file."""
    of_hits: Results = {"force": 1, "response": (2,), "window": "exponential"}

    def answer(content: str | bytes) -> object:
        with TemporaryDirectory() as folder:
            path = Path(folder, f"test{ending}")
            path.write_bytes(content if isinstance(content, bytes) else content.encode())
            return cb.poles(path, order=10, **(of_hits if ending == ".wav" else {}))

    return answer


def _read(text: str) -> object:
    return parse_specimen(text, "plate.toml")


def _read_table(text: str) -> object:
    """Modes of a table; ``None`` if it is refused."""
    rows, problems = read_modes_table(text)
    modes = None
    if rows is not None:
        modes, problems = modes_of(rows, complete=True)
    if (modes is None) != bool(problems):
        raise AssertionError("neither modes nor a reason, or both")
    return modes


def _made_by_hypothesis(
    kind: str,
    strategy: st.SearchStrategy[Content],
    read: Callable[[Content], object],
    refusals: type[Exception] | tuple[type[Exception], ...],
    most: int,
    seconds: float,
) -> Tally:
    tally = Tally(kind, refusals, most, seconds)
    rng = np.random.default_rng(SEED)
    batch = 0
    while tally.is_open:
        made = _made(strategy, SEED + batch, min(BATCH, max(1, most // (1 + CROSSED))))
        for content in made:
            tally.record(content, partial(read, content))
        for _ in range(CROSSED * len(made)):
            one, other = (made[i] for i in rng.integers(len(made), size=2))
            content = crossed(one, other, rng)
            tally.record(content, partial(read, content))
        batch += 1
    return tally


def _made(strategy: st.SearchStrategy[Content], number: int, most: int) -> list[Content]:
    """Inputs that hypothesis makes from one seed."""
    made: list[Content] = []

    @seed(number)
    @settings(
        max_examples=most,
        phases=[Phase.generate],
        deadline=None,
        database=None,
        suppress_health_check=list(HealthCheck),
    )
    @given(strategy)
    def keep(content: Content) -> None:
        made.append(content)

    keep()
    return made


def _large_files() -> Tally:
    tally = Tally("plate files of the size limit", PlateFileError, len(LARGE_FILES), float("inf"))
    for text in LARGE_FILES.values():
        tally.record(text[:60], partial(_read, text))
    return tally


def _large_universal_files() -> Tally:
    """Outcomes for universal files and tables of modes and of responses at their limits of size."""
    both = len(LARGE_UNIVERSAL_FILES)
    refusals = (UniversalFileError, ModalTestError)
    tally = Tally(
        "universal files and tables of 10 to 20 MB", refusals, 2 * both + len(LARGE_TABLES), float("inf")
    )
    for name, made in LARGE_UNIVERSAL_FILES.items():
        tally.record(name, partial(_read_shapes, made(MAX_UNIVERSAL_BYTES)))
        tally.record(name, partial(_poles_of(".unv"), made(MAX_UNIVERSAL_BYTES // 2)))
    for name, made in LARGE_TABLES.items():
        tally.record(name, partial(_poles_of(".csv"), made(MAX_UNIVERSAL_BYTES)))
    return tally


def _damaged_files(most: int, seconds: float) -> Tally:
    """Outcomes for stored arrays after each kind of damage in turn; they must read back as nothing."""
    tally = Tally("damaged stored files", (), most, seconds)
    rng = np.random.default_rng(SEED)
    logging.getLogger("cpam_bayes").addHandler(logging.NullHandler())
    with TemporaryDirectory() as folder:
        path = Path(folder, "model.arrays")
        write_arrays(path, {"stack": rng.standard_normal((6, 8, 8)), "name": np.array("a text")})
        whole = path.read_bytes()
        while tally.is_open:
            for damage in DAMAGES.values():
                content = damage(whole, rng)
                if content != whole:
                    path.write_bytes(content)
                    tally.record(content[:60], lambda: read_arrays(path))
    return tally


def _wrong_arguments(most: int, seconds: float) -> Tally:
    """Outcomes for every argument of every public function, given a value of a wrong type."""
    tally = Tally("arguments of wrong types", (ArgumentError, ValueError), most, seconds)
    with TemporaryDirectory() as folder, contextlib.chdir(folder):  # some write files
        _give_arguments(tally)
    return tally


def _give_arguments(tally: Tally) -> None:
    for name, keyword, value in _arguments():
        verb = getattr(cb, name)
        wanted = list(inspect.signature(verb).parameters.values())
        given_ = {p.name: "no such plate" for p in wanted if p.default is p.empty} | {keyword: value}
        several = next((i for i, p in enumerate(wanted) if p.kind is p.VAR_POSITIONAL), -1)
        places = [given_.pop(p.name, p.default) for p in wanted[: several + 1]]
        tally.record((name, keyword, value), partial(verb, *places, **given_))


def _arguments() -> Iterator[tuple[str, str, object]]:
    for name in cb.__all__:
        verb = getattr(cb, name)
        if inspect.isfunction(verb) and name != "app":  # which would serve until it is stopped
            for keyword in inspect.signature(verb).parameters:
                for value in WRONG:
                    yield name, keyword, value


def _signalled(which: str, name: str) -> Results:
    """Send a signal to a long command while it computes, then run a short one in the same directory."""
    command = [sys.executable, "-m", "cpam_bayes"]
    # programs started in the background ignore these signals, and so would the command
    signal.signal(signal.SIGINT, signal.default_int_handler)
    signal.signal(signal.SIGHUP, signal.SIG_DFL)
    with TemporaryDirectory() as folder:
        out = Path(folder, "out")
        environment = {**os.environ, "TMPDIR": folder, "CPAM_BAYES_CACHE": str(Path(folder, "cache"))}
        computing, *long = [*LONG[which], "--out", str(out)]
        started = subprocess.Popen(
            [*command, *long], env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
        assert started.stderr is not None
        if not any(computing in line for line in started.stderr):
            raise AssertionError(f"{which}: ended before a signal was sent")
        started.send_signal(getattr(signal, name))
        _, said = started.communicate()
        left = _drafts(folder)
        short = ["forward", "A1", "--modes", "2", "--quiet", "--out", str(out)]
        again = subprocess.run([*command, *short], env=environment, capture_output=True, check=False)
        return {
            "command": which,
            "signal": name,
            "status": started.returncode,
            "traceback": "Traceback" in said,
            "left": left,
            "next_status": again.returncode,
            "left_after_the_next": _drafts(folder),
        }


def _drafts(folder: str) -> int:
    return sum(path.name.startswith(".cpam-bayes-") for path in Path(folder).rglob("*"))


def sections(results: Results) -> dict[str, str]:
    """Section of docs/robustness.md on the results."""
    kinds, failed = results["kinds"], sum(row["failed"] for row in results["kinds"])
    inputs = sum(row["inputs"] for row in kinds)
    slowest = max(row["slowest_seconds"] for row in kinds)
    accepted = sum(row["accepted"] for row in kinds)
    tried = listed([row["kind"] for row in kinds])
    said = paragraph(
        f"{counted(inputs)} inputs ({tried}): {counted(accepted)} gave an answer, "
        f"{failed if failed else 'none'} failed, the others ended with a message. The slowest took "
        f"{slowest:.2g} s of a core; the process held {results['memory_gib']:.2g} GiB at most."
    )
    commands = dict.fromkeys(row["command"] for row in results["signals"])
    signals = []
    for name in dict.fromkeys(row["signal"] for row in results["signals"]):
        of = [row for row in results["signals"] if row["signal"] == name]
        signals.append(f"{name} {_seen(of, 'status')}, {_seen(of, 'left')}")
    sent = (
        f"Exit status and temporary files left, each signal sent to each of {len(commands)} commands: "
        f"{'; '.join(signals)}. "
        f"The next command ended with status {_seen(results['signals'], 'next_status')} and left "
        f"{_seen(results['signals'], 'left_after_the_next')} files."
    )
    return {"inputs": said, "signals": paragraph(sent)}


def _seen(rows: Sequence[Results], key: str) -> str:
    return listed(sorted({str(row[key]) for row in rows}))


def show(results: Results) -> None:
    """Print both tables."""
    columns = tuple(
        Heading(text.removeprefix("#"), text.startswith("#"))
        for text in ("kind", "#inputs", "#accepted", "#refused", "#failed", "#slowest s")
    )
    rows = tuple(tuple(str(v) for v in row.values()) for row in results["kinds"])
    tables = [Table("Hostile inputs", columns, rows)]
    names = tuple(
        Heading(text.removeprefix("#"), text.startswith("#"))
        for text in ("command", "signal", "#status", "traceback", "#left", "#next status", "#left after it")
    )
    tables.append(
        Table("Signals", names, tuple(tuple(str(v) for v in row.values()) for row in results["signals"]))
    )
    print(screen_text(tables, sys.stdout))
    for failure in results["failures"]:
        print(failure)


def main() -> None:
    """Run the study, show and save the results, and write the page."""
    parser = study_parser(__doc__)
    parser.add_argument("--minutes", type=float, default=10.0, help="time for the inputs (default: 10)")
    parser.add_argument("--inputs", type=int, default=INPUTS, help=f"of a kind at most (default: {INPUTS})")
    options = parser.parse_args()
    results = run(options.quick, options.inputs, options.minutes)
    show(results)
    if not options.quick:
        save_results(RESULTS, results)
        write_sections(HERE.parent, RESULTS.stem, sections(results))


if __name__ == "__main__":
    main()
