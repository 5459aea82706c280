"""A command of the command line as a record: its options are the arguments of a verb of the library.

This module loads nothing beyond the standard library, so that a question's options can be read quickly.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from cpam_bayes.plate import Specimen
    from cpam_bayes.result import Result

DEFAULT_SEED: Final = 0
MAX_MODES: Final = 100
MAX_WORKERS: Final = 1000
MAX_SECONDS: Final = 1e7
STATUS_TEXT: Final = """\
exit status: 0 done, 1 ran and did not reach its goal, 2 bad input, 130 interrupted.
PLATE is a built-in specimen (`cpam-bayes plates` lists them) or the path of a plate file.
"""


@dataclass(frozen=True, slots=True)
class Option:
    """An argument of the parser.

    name : "--modes", or "plate" for a positional one
    argument : of the verb, None for one that the command line itself uses
    settings : keyword arguments of `argparse.ArgumentParser.add_argument`
    """

    name: str
    argument: str | None
    settings: Mapping[str, Any]

    @property
    def key(self) -> str:
        """Its attribute in the parsed options."""
        return str(self.settings.get("dest") or self.name.lstrip("-").replace("-", "_"))

    def add_to(self, parser: argparse.ArgumentParser) -> None:
        """Add the option to a parser."""
        parser.add_argument(self.name, **self.settings)


def add_executor_options(parser: argparse.ArgumentParser) -> None:
    """Add `--executor` and `--workers` to the parser of a script."""
    EXECUTOR.add_to(parser)
    WORKERS.add_to(parser)


def option(name: str, argument: str | None = "", **settings: Any) -> Option:
    """An option as argparse takes it; argument : of the verb, by default the option's name."""
    plain = name.lstrip("-").replace("-", "_")
    return Option(name, plain if argument == "" else argument, MappingProxyType(settings))


@dataclass(frozen=True, slots=True)
class Command:
    """A command: the verb that answers it, and its options in the order of the help.

    verb : called with the positional arguments in order, lists unpacked, and all others by name; an option
        with the default `argparse.SUPPRESS` takes the verb's default
    options : a name without "--" is positional
    out : help of `--out DIR`, None for a command that writes no files there
    watched : whether the verb shows progress to a `watch`
    seeded : whether the verb takes a `seed`
    asks : asks the user for further arguments, by name, given the others; not called with `--json`
    """

    verb: Callable[..., Result]
    options: tuple[Option, ...] = ()
    out: str | None = "write result files and figures to DIR"
    watched: bool = True
    seeded: bool = True
    asks: Callable[..., Mapping[str, Any]] | None = None

    def add_to(self, parser: argparse.ArgumentParser) -> None:
        """Add the options to a parser, after those common to all commands."""
        parser.add_argument("--json", action="store_true", help="one JSON document in place of the screen")
        parser.add_argument(
            "--seed",
            type=whole(0, 2**63 - 1),
            default=DEFAULT_SEED,
            metavar="N",
            help=f"seed: the same one gives the same answer (default: {DEFAULT_SEED})",
        )
        if self.out is None:
            parser.set_defaults(out=None)
        else:
            parser.add_argument("--out", metavar="DIR", help=self.out)
        parser.add_argument("--csv", metavar="FILE", help="write the main table to FILE")
        parser.add_argument("--xlsx", metavar="FILE", help="write all tables to a workbook, one sheet each")
        parser.add_argument("--verbose", action="store_true", help="also the tables behind the answer")
        parser.add_argument("--quiet", action="store_true", help="no progress on standard error")
        for each in self.options:
            each.add_to(parser)

    def prepare(
        self, args: argparse.Namespace, read: Mapping[str, Specimen] = MappingProxyType({})
    ) -> Callable[[], Result]:
        """The verb bound to its arguments; read : plates already read, by path."""
        positional: list[Any] = []
        named: dict[str, Any] = {"seed": args.seed} if self.seeded else {}
        for each in self.options:
            if each.argument is None or not hasattr(args, each.key):
                continue
            value = getattr(args, each.key)
            if each.name.startswith("-"):
                named[each.argument] = value
            else:
                positional += value if isinstance(value, list) else [value]
        if self.asks is not None and not args.json:
            named |= self.asks(*positional, **named)
        if self.watched:
            from cpam_bayes.render.terminal import Terminal

            named["watch"] = Terminal(args.quiet)
        return partial(self.verb, *(read.get(str(value), value) for value in positional), **named)


def whole(low: int, high: int) -> Callable[[str], int]:
    """A reader of whole numbers between two bounds; it raises argparse's error for anything else."""

    def read(text: str) -> int:
        # int() also takes "1_000", and a number of a million digits takes it minutes.
        if text.isascii() and text.isdigit() and len(text) < 20 and low <= int(text) <= high:
            return int(text)
        shown = text if len(text) < 40 else f"{text[:40]}..."
        raise argparse.ArgumentTypeError(f"received {shown!r}, accepted: a whole number from {low} to {high}")

    return read


def positive(most: float, what: str = "number") -> Callable[[str], float]:
    """A reader of numbers above 0 and at most ``most``; it raises argparse's error for anything else."""

    def read(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if 0.0 < value <= most:
            return value
        shown = text if len(text) < 40 else f"{text[:40]}..."
        raise argparse.ArgumentTypeError(
            f"received {shown!r}, accepted: a {what} above 0 and at most {most:g}"
        )

    return read


def _executor(text: str) -> str:
    from cpam_bayes.parallel import read_spec

    try:
        return read_spec(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error).removeprefix("executor: ")) from error


PLATE: Final = option("plate", metavar="PLATE", help="built-in specimen or path of a plate file")
PLATES: Final = option(
    "plates",
    nargs="+",
    metavar="PLATE",
    help="built-in specimens or paths of plate files; several are plates of one material, which "
    "share their constants, or with equal `specimen` one plate under several tests",
)
MODES: Final = option(
    "--modes",
    "n_modes",
    type=whole(1, MAX_MODES),
    metavar="N",
    help=f"number of modes, 1 to {MAX_MODES} (default: as many as were measured, or 10)",
)
EXECUTOR: Final = option(
    "--executor",
    type=_executor,
    default="processes",
    metavar="WHERE",
    help="where the work is done: processes of this machine, serial: in this process, or dask://HOST:PORT: "
    "a running Dask cluster (tls://HOST:PORT: with TLS); the answer is the same (default: processes)",
)
WORKERS: Final = option(
    "--workers",
    type=whole(1, MAX_WORKERS),
    metavar="N",
    help=f"number of processes, 1 to {MAX_WORKERS} (default: one per core)",
)
TIME_LIMIT: Final = option(
    "--time-limit",
    None,
    type=positive(MAX_SECONDS, "number of seconds"),
    metavar="S",
    help="end after about S seconds with the best answer so far, which says what is missing; exit status 1 "
    "then (default: none)",
)
