"""The command line: an answer on standard output, warnings and errors on standard error.

Only the standard library is imported here; the module of a question is loaded when it is asked.
"""

from __future__ import annotations

import argparse
import json
import logging
import os
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext, suppress
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NoReturn, TextIO

from cpam_bayes import __version__
from cpam_bayes.command import STATUS_TEXT, Command

if TYPE_CHECKING:
    from cpam_bayes.plate import Specimen
    from cpam_bayes.result import Result

COMMANDS: Final = {
    "app": "a page on this machine: a plate, its frequencies, and the constants as you type",
    "plates": "the built-in specimens",
    "new": "a commented plate file to start from",
    "poles": "natural frequencies and damping from frequency responses or recorded hits",
    "forward": "natural frequencies from the reference constants",
    "export": "an input file for CalculiX and ABAQUS, or predicted modes for modal software",
    "identify": "constants from the measured frequencies",
    "predict": "frequencies of another plate from a stored posterior",
    "design": "specimens and tests ranked by how well they would determine the constants",
    "sensitivity": "the paper's repetition on perturbed frequencies beside the posterior",
    "sequence": "the probability of every stacking sequence on the grid",
    "diagnose": "errors of plate, list or model by their probability, and constants that allow for them",
    "report": "constants, stacking sequences and diagnosis on one page",
    "batch": "the constants of many plates, one row each, with limits and a control chart",
    "compare": "do two plates differ? Their constants against each other",
    "paper": "the paper's tables beside what this package computes",
    "prove": "the coin test: was a mass stuck to the plate, how heavy, where",
    "calibrate": "how often the intervals of a plate contain the true constants, from simulated lists",
}
"""Command, also the name of its module in `cpam_bayes.questions` -> what it answers."""
BAD_INPUT: Final = 2
NOT_WRITTEN: Final = 1
NOT_DONE: Final = 1


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command and return its exit status; argparse leaves by `SystemExit`."""
    return prepare(sys.argv[1:] if argv is None else argv)()


def prepare(argv: Sequence[str]) -> Callable[[], int]:
    """Parse the options and load what the command needs; return the function that runs it."""
    try:
        command, parser = _asked(argv)
        args = parser.parse_args(argv)
    except BrokenPipeError:
        raise
    except OSError as error:  # of help or version, which the parser shows
        return partial(_not_shown, error)
    try:
        if args.out is not None:
            import_module("matplotlib.figure")  # before the work: what is missing is said at once
        assert command is not None, "argparse requires a command"
        if args.csv is not None or args.xlsx is not None:
            from cpam_bayes.render.files import require_table

            require_table(args.csv, "csv")
            require_table(args.xlsx, "xlsx")
        work = command.prepare(args)
    except ValueError as error:
        return partial(_refuse, error)
    return partial(_finish, work, args, command, {})


def _refuse(error: ValueError) -> int:
    for problem in getattr(error, "problems", (str(error),)):
        print(f"error: {problem}", file=sys.stderr)
    return BAD_INPUT


def _not_shown(error: OSError) -> int:
    """Report that an answer could not be written, and discard the rest of it."""
    print(f"error: standard output: {error.strerror}; the answer was not written", file=sys.stderr)
    with suppress(OSError):  # a stream that is no file
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    return NOT_WRITTEN


def _finish(
    work: Callable[[], Result], args: argparse.Namespace, command: Command, read: Mapping[str, Specimen]
) -> int:
    """Run the command, save its files, and show its answer even if they could not be saved.

    read : plates whose table columns the user has chosen, by path
    """
    from numpy.linalg import LinAlgError

    from cpam_bayes.parallel import WorkersLostError
    from cpam_bayes.render.files import save, save_tables, staging
    from cpam_bayes.render.terminal import forecasting
    from cpam_bayes.running import TimeIsUpError, time_limit

    not_saved: Exception | None = None
    notes: tuple[str, ...] = ()
    store: str | None = getattr(args, "store", None)
    try:
        with _warnings_shown(), staging(args.out) as stage:
            forecast = nullcontext() if getattr(args, "quiet", True) else forecasting()
            with forecast, time_limit(getattr(args, "time_limit", None)):
                answer = work()
            try:
                notes = save(answer, stage)
                save_tables(answer, args.csv, args.xlsx)
            except (OSError, ValueError) as error:  # no fault of the input: the answer is shown all the same
                not_saved = error
    except KeyboardInterrupt:
        if store is not None and any(Path(store).glob("*")):
            print(f"what was finished is kept in {store}: the same command resumes there", file=sys.stderr)
        elif store is None and hasattr(args, "store"):
            print("nothing was kept; with --store DIR the same command would resume", file=sys.stderr)
        raise
    except LinAlgError as error:  # a ValueError too, and no fault of the input
        print(f"error: a plate model cannot be solved, please report it: {error}", file=sys.stderr)
        return NOT_DONE
    except ValueError as error:
        try:
            plate = None if args.json else _with_columns(error)
        except ValueError as other:
            return _refuse(other)
        if plate is None:
            return _refuse(error)
        known = {**read, plate.source: plate}
        return _finish(command.prepare(args, known), args, command, known)
    except (WorkersLostError, TimeIsUpError) as error:
        print(f"error: {error}", file=sys.stderr)
        return NOT_DONE
    # on a terminal the screen shows the slips itself
    shown = not args.json and _is_terminal(sys.stdout) and _is_terminal(sys.stderr)
    for warning in answer.cautions if shown else answer.warnings:
        print(f"warning: {warning}", file=sys.stderr)
    for note in notes:
        print(f"note: {note}", file=sys.stderr)
    try:
        _show(answer, args.json, args.verbose)
    except BrokenPipeError:
        raise
    except OSError as error:
        return _not_shown(error)
    if not_saved is not None:
        where = ", ".join(f"--{n} {v}" for n, v in vars(args).items() if n in ("out", "csv", "xlsx") and v)
        print(f"error: {where}: {not_saved}; not all files were written", file=sys.stderr)
        return NOT_WRITTEN
    return 0 if answer.reached_goal else NOT_DONE


def _with_columns(error: ValueError) -> Specimen | None:
    """The plate with the table columns that the user chose at the terminal; None where none were."""
    heads, file = getattr(error, "choices", ()), getattr(error, "source", "")
    is_plate = file.casefold().endswith(".toml")  # a list of `prove` has nowhere to keep the answer
    if not (heads and is_plate and _is_terminal(sys.stdin) and _is_terminal(sys.stdout)):
        return None
    from cpam_bayes.plate import read_specimen

    listed = "".join(f"  {i}  {head}\n" for i, head in enumerate(heads, 1))
    print(f"{file}: which column of its table has the frequencies?\n{listed}", end="", file=sys.stderr)
    while True:
        print("Its number, or several if each mode or hit has one: ", end="", file=sys.stderr, flush=True)
        try:
            words = input().split()
        except EOFError:
            words = []
        if not words:
            return None
        if all(word.isdecimal() and 0 < int(word) <= len(heads) for word in words):
            break
        print(f"  received {' '.join(words)!r}, accepted: 1 to {len(heads)}", file=sys.stderr)
    chosen = [heads[int(word) - 1] for word in words]
    value = json.dumps(chosen[0] if len(chosen) == 1 else chosen, ensure_ascii=False)
    print(f"To keep this, add to {file}\n  [measurement.columns]\n  hz = {value}", file=sys.stderr)
    return read_specimen(file, chosen)


def _is_terminal(stream: TextIO | None) -> bool:
    return stream is not None and stream.isatty()


@contextmanager
def _warnings_shown() -> Iterator[None]:
    """Show log messages of the package, such as a damaged file set aside, as warnings."""
    log, handler = logging.getLogger("cpam_bayes"), logging.StreamHandler()
    handler.setFormatter(logging.Formatter("warning: %(message)s"))
    log.addHandler(handler)
    try:
        yield
    finally:
        log.removeHandler(handler)


def _show(answer: Result, as_json: bool, verbose: bool) -> None:
    from cpam_bayes.render.report import json_text
    from cpam_bayes.render.terminal import screen_tables, screen_text

    stream = sys.stdout
    if stream is None:  # closed by the caller
        return
    if as_json:
        text = json_text(answer.to_dict())
    else:
        text = screen_text(screen_tables(answer.report(), verbose=verbose), stream)
    encoding = stream.encoding or "utf-8"
    _write(text.encode(encoding, "backslashreplace").decode(encoding), stream)


def _write(text: str, stream: TextIO) -> None:
    stream.write(text)
    stream.flush()


class _Parser(argparse.ArgumentParser):
    """A parser that raises ``OSError`` where help or version cannot be written; argparse ignores that.

    What it refuses is said in one line, without the usage.
    """

    def error(self, message: str) -> NoReturn:
        """Leave with what is wrong, and where the options are listed."""
        self.exit(BAD_INPUT, f"error: {message} (see {self.prog} --help)\n")

    def print_help(self, file: Any = None) -> None:
        """Write the help, by default to standard output."""
        stream = sys.stdout if file is None else file
        if stream is not None:
            _write(self.format_help(), stream)


class _Version(argparse.Action):
    """Show the version and leave."""

    def __call__(self, parser: argparse.ArgumentParser, *args: object) -> None:
        if sys.stdout is not None:
            _write(f"cpam-bayes {__version__}\n", sys.stdout)
        parser.exit()


def _asked(argv: Sequence[str]) -> tuple[Command | None, argparse.ArgumentParser]:
    """The requested command, and a parser with its options; other commands are only listed in the help."""
    parser = _Parser(
        prog="cpam-bayes",
        description="Elastic constants of composite plates from their natural frequencies.",
        epilog=STATUS_TEXT,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    parser.add_argument("--version", action=_Version, nargs=0, help="show program's version number and exit")
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", required=True)
    asked = next((word for word in argv if not word.startswith("-")), None)
    found: Command | None = None
    for name, what in COMMANDS.items():
        added = commands.add_parser(
            name,
            help=what,
            description=f"{what[0].upper()}{what[1:]}.",
            epilog=STATUS_TEXT,
            formatter_class=argparse.RawDescriptionHelpFormatter,
            allow_abbrev=False,
        )
        if name == asked:
            found = import_module(f"cpam_bayes.questions.{name}").COMMAND
            found.add_to(added)
    return found, parser
