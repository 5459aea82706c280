"""The command line: options in, an answer to standard output, warnings and errors beside it.

Only the standard library is imported here; a command's own module loads once it was asked for.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Callable, Sequence
from functools import partial
from importlib import import_module
from typing import TYPE_CHECKING, Final

from cpam_bayes import __version__
from cpam_bayes.commands import BACKENDS, DEFAULT_SEED, ELEMENTS, MAX_MODES, NOISE_SHAPES, SOLVERS
from cpam_bayes.commands.options import add_executor_options, whole

if TYPE_CHECKING:
    from cpam_bayes.result import Result

BAD_INPUT: Final = 2
NOT_WRITTEN: Final = 1
NOT_DONE: Final = 1
MOST_NOISE: Final = 50.0
MOST_SCATTER: Final = 0.5
MOST_PRIOR: Final = 0.99

_STATUS_TEXT: Final = """\
exit status: 0 done, 1 ran and did not reach its goal, 2 bad input, 130 interrupted.
PLATE is a built-in specimen (`cpam-bayes plates` lists them) or the path of a plate file.
"""


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command and return its exit status; argparse leaves by `SystemExit`."""
    return prepare(sys.argv[1:] if argv is None else argv)()


def prepare(argv: Sequence[str]) -> Callable[[], int]:
    """Read the options and the plate file and load what the command needs; return its work."""
    args = _parser().parse_args(argv)
    try:
        if args.out is not None:
            import_module("cpam_bayes.report.figures")
        module = import_module(f"cpam_bayes.commands.{args.command}")
        work: Callable[[], Result] = module.prepare(args)
    except ValueError as error:
        return partial(_refuse, error)
    return partial(_finish, work, args)


def _refuse(error: ValueError) -> int:
    for problem in getattr(error, "problems", (str(error),)):
        print(f"error: {problem}", file=sys.stderr)
    return BAD_INPUT


def _finish(work: Callable[[], Result], args: argparse.Namespace) -> int:
    """Do the work, save its files, and show its answer even if they could not be saved."""
    from cpam_bayes.parallel import WorkersLostError
    from cpam_bayes.report.files import save, staging

    not_saved: OSError | None = None
    try:
        with staging(args.out) as stage:
            answer = work()
            try:
                save(answer, stage)
            except OSError as error:
                not_saved = error
    except ValueError as error:
        return _refuse(error)
    except WorkersLostError as error:
        print(f"error: {error}", file=sys.stderr)
        return NOT_DONE
    for warning in answer.warnings:
        print(f"warning: {warning}", file=sys.stderr)
    try:
        _show(answer, args.json)
    except BrokenPipeError:
        raise
    except OSError:  # a full disk, which is said when standard output is closed
        return NOT_WRITTEN
    if not_saved is not None:
        print(f"error: --out {args.out}: {not_saved}; not all files are there", file=sys.stderr)
        return NOT_WRITTEN
    return 0 if answer.reached_goal else NOT_DONE


def _show(answer: Result, as_json: bool) -> None:
    from cpam_bayes.report.documents import json_text
    from cpam_bayes.report.tables import screen_text

    stream = sys.stdout
    if stream is None:  # closed by the caller
        return
    text = json_text(answer.to_dict()) if as_json else screen_text(answer.tables(), stream)
    encoding = stream.encoding or "utf-8"
    stream.write(text.encode(encoding, "backslashreplace").decode(encoding))
    stream.flush()


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="cpam-bayes",
        description="Elastic constants of composite plates from their natural frequencies.",
        epilog=_STATUS_TEXT,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    parser.add_argument("--version", action="version", version=f"cpam-bayes {__version__}")
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", required=True)
    _command(commands, "plates", "list the built-in specimens")

    forward = _command(commands, "forward", "natural frequencies from the reference constants")
    forward.add_argument("plate", metavar="PLATE", help="built-in specimen or path of a plate file")
    forward.add_argument(
        "--solver",
        choices=SOLVERS,
        help="ritz; fem: finite elements, which also take [plate] mesh; ccx: the program CalculiX "
        "(default: fem for a plate with a mesh, ritz for the others)",
    )
    forward.add_argument(
        "--element",
        choices=ELEMENTS,
        help="ccx: brick, 20 nodes, in layers of plies, or shell, 8 nodes (default: brick)",
    )
    _modes(forward)

    export = _command(commands, "export", "write the plate as an input file of CalculiX and ABAQUS", out=None)
    export.add_argument("plate", metavar="PLATE", help="built-in specimen or path of a plate file")
    export.add_argument(
        "--to", choices=("ccx",), required=True, help="ccx: CalculiX, and ABAQUS reads it too"
    )
    export.add_argument(
        "--element",
        choices=ELEMENTS,
        default="shell",
        help="shell, 8 nodes (S8R), or brick, 20 nodes, in layers of plies (C3D20R) (default: shell)",
    )
    _modes(export)
    export.add_argument(
        "--out",
        dest="file",
        metavar="FILE",
        help="the file to write, not a directory as of other commands (default: PLATE.inp, here)",
    )
    export.add_argument("--force", action="store_true", help="write over a file that is there")
    export.set_defaults(out=None)

    identify = _command(commands, "identify", "constants from the measured frequencies")
    identify.add_argument("plate", metavar="PLATE", help="built-in specimen or path of a plate file")
    identify.add_argument(
        "--backend",
        choices=BACKENDS,
        default="pso",
        help="pso: the paper's particle swarm; emcee: the posterior, sampled from that swarm on",
    )
    identify.add_argument(
        "--residuals",
        choices=("absolute", "relative"),
        help="pso: what the swarm minimises, squares of differences in Hz, eq. (7), or of relative ones "
        "(default: absolute)",
    )
    identify.add_argument(
        "--particles",
        type=whole(5, 10_000),
        metavar="N",
        help="pso: particles of the swarm, 5 to 10000 (default: 40)",
    )
    identify.add_argument(
        "--iterations",
        type=whole(1, 100_000),
        metavar="N",
        help="pso: budget of the swarm, 1 to 100000 iterations (default: 400)",
    )
    identify.add_argument(
        "--steps",
        type=whole(1, 10_000_000),
        metavar="N",
        help="emcee: budget of the chains in steps, used in rounds of 100 (default: 10000)",
    )
    identify.add_argument(
        "--store",
        metavar="DIR",
        help="emcee: keep finished rounds in DIR; the same command goes on from there",
    )
    identify.add_argument(
        "--likelihood",
        choices=("relative", "absolute"),
        help="emcee: noise in proportion to a frequency, or one standard deviation in Hz for all modes, "
        "which is inferred: eq. (7) (default: relative)",
    )
    identify.add_argument(
        "--noise",
        choices=tuple(NOISE_SHAPES),
        help="emcee: gaussian, or student-t with 4 degrees of freedom, which a few bad frequencies do "
        "not sway (default: gaussian)",
    )

    _sensitivity(commands)
    _sequence(commands)
    _diagnose(commands)
    return parser


def _diagnose(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    what = "what the plate model gets wrong, the cause by its probability, the extended model and its gain"
    command = _command(commands, "diagnose", what)
    command.add_argument(
        "plates",
        nargs="+",
        metavar="PLATE",
        help="built-in specimens or paths of plate files; several are plates of one material, which share "
        "their constants, or with equal `specimen` one plate under several tests",
    )
    command.add_argument(
        "--scatter",
        type=partial(_share, most=MOST_SCATTER),
        default=0.02,
        metavar="S",
        help="standard deviation of a constant from plate to plate of one material, relative, above 0, at "
        "most 0.5 (default: 0.02)",
    )
    command.add_argument(
        "--prior-none",
        type=partial(_share, most=MOST_PRIOR),
        metavar="P",
        help="probability beforehand that nothing is wrong, above 0, at most 0.99 (default: 0.5)",
    )
    command.add_argument(
        "--next",
        choices=("open", "always", "never"),
        default="open",
        help="when to say which further test would tell most about the cause: while the cause is open, "
        "always, or never (default: open)",
    )
    command.add_argument(
        "--emcee",
        action="store_true",
        help="sample the constants of the extended model by emcee too",
    )


def _sequence(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    command = _command(commands, "sequence", "the probability of every stacking sequence on the grid")
    command.add_argument(
        "plate",
        metavar="PLATE",
        help='built-in specimen, with the unknown angles of Table 9(b), or path of a plate file with "?" '
        "in its layup",
    )
    command.add_argument(
        "--top",
        type=whole(1, 2000),
        default=100,
        metavar="N",
        help="most probable sequences in the JSON document, 1 to 2000 (default: 100)",
    )
    add_executor_options(command)


def _sensitivity(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    what = "noisy lists inverted again and again, beside the posterior at that noise"
    command = _command(commands, "sensitivity", what)
    command.add_argument("plate", metavar="PLATE", help="built-in specimen or path of a plate file")
    command.add_argument(
        "--levels",
        type=_level,
        nargs="+",
        default=(1.0, 5.0, 10.0),
        metavar="P",
        help="levels of noise in percent, above 0, at most 50 (default: 1 5 10)",
    )
    command.add_argument(
        "--groups",
        type=whole(2, 1000),
        default=10,
        metavar="N",
        help="noisy lists at each level, 2 to 1000 (default: 10)",
    )
    command.add_argument(
        "--reading",
        choices=("both", "relative", "rms"),
        default="both",
        help="eq. (12) as a share of each frequency, or of the root mean square frequency for all modes "
        "(default: both)",
    )
    command.add_argument(
        "--list",
        choices=("model", "measured"),
        default="model",
        help="what noise is added to: the frequencies that the plate model gives at the reference constants, "
        "or the measured ones, as the paper does (default: model)",
    )
    _modes(command)
    add_executor_options(command)


def _modes(command: argparse.ArgumentParser) -> None:
    command.add_argument(
        "--modes",
        type=whole(1, MAX_MODES),
        metavar="N",
        help=f"number of modes, 1 to {MAX_MODES} (default: as many as were measured, or 10)",
    )


def _command(
    commands: argparse._SubParsersAction[argparse.ArgumentParser],
    name: str,
    what: str,
    out: str | None = "write result files and figures to DIR",
) -> argparse.ArgumentParser:
    """Add a command with the options that all commands have; out : help of `--out DIR`, None for none."""
    parser = commands.add_parser(
        name,
        help=what,
        description=f"{what[0].upper()}{what[1:]}.",
        epilog=_STATUS_TEXT,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    parser.add_argument("--json", action="store_true", help="print one JSON document instead of the screen")
    parser.add_argument(
        "--seed",
        type=whole(0, 2**63 - 1),
        default=DEFAULT_SEED,
        metavar="N",
        help=f"seed: the same one gives the same answer (default: {DEFAULT_SEED})",
    )
    if out is not None:
        parser.add_argument("--out", metavar="DIR", help=out)
    parser.add_argument("--quiet", action="store_true", help="no progress on standard error")
    return parser


def _share(text: str, most: float) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if 0.0 < value <= most:
        return value
    shown = text if len(text) < 40 else f"{text[:40]}..."
    raise argparse.ArgumentTypeError(f"received {shown!r}, accepted: a number above 0 and at most {most:g}")


def _level(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if 0.0 < value <= MOST_NOISE:
        return value
    shown = text if len(text) < 40 else f"{text[:40]}..."
    raise argparse.ArgumentTypeError(
        f"received {shown!r}, accepted: a percentage above 0 and at most {MOST_NOISE:g}"
    )
