"""The command `cpam-bayes`: one BLAS thread, and a clean end when it is interrupted."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Callable, Sequence
from types import FrameType

# Before numpy loads: on small eigenproblems BLAS threads cost more than they gain.
for _name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

INTERRUPTED = 130
# Ctrl-C, a scheduler or `kill`, a closed terminal, on Windows Ctrl-Break: those that the system has
_NAMES = ("SIGINT", "SIGTERM", "SIGHUP", "SIGBREAK")
_ENDING = tuple(signal.Signals(getattr(signal, name)) for name in _NAMES if hasattr(signal, name))
_UNTOUCHED = (signal.SIG_DFL, signal.default_int_handler)
_MESSAGE = "cpam-bayes: interrupted\n"


def main() -> int:
    """Run the command line and return its exit status."""
    # A shell may have told us to ignore a signal, as for jobs in the background or under nohup.
    heard = [number for number in _ENDING if signal.getsignal(number) in _UNTOUCHED]
    try:
        _listen(heard, _leave)
        status = _run(heard)
    except KeyboardInterrupt:
        _listen(heard, signal.SIG_IGN)
        os.write(2, _MESSAGE.encode())
        # An interrupt inside exec of a text, as in the making of a dataclass, marks the process to die of
        # SIGINT though it was caught here; the next exec takes the mark away (CPython, `run_eval_code_obj`).
        exec("")
        status = INTERRUPTED
    except SystemExit as leaving:  # argparse: help, version, or options it refuses
        status = leaving.code if isinstance(leaving.code, int) else 0
    except BrokenPipeError:  # the reader of the answer has seen enough
        status = 0
    return _flushed(status)


def _run(heard: Sequence[signal.Signals]) -> int:
    from cpam_bayes.cli import prepare

    work = prepare(sys.argv[1:])
    _listen(heard, _interrupt)
    return work()


def _listen(numbers: Sequence[signal.Signals], handler: Callable[..., object] | signal.Handlers) -> None:
    for number in numbers:
        signal.signal(number, handler)


def _leave(signal_number: int, frame: FrameType | None) -> None:
    """Exit at once: an exception during a library's import does not always propagate."""
    os.write(2, _MESSAGE.encode())
    os._exit(INTERRUPTED)


def _interrupt(signal_number: int, frame: FrameType | None) -> None:
    """Clean up and exit; where a session is ended by several signals, the first one counts."""
    if signal_number != signal.SIGINT:
        _listen([number for number in _ENDING if number != signal.SIGINT], signal.SIG_IGN)
    raise KeyboardInterrupt


def _flushed(status: int) -> int:
    """Flush standard output; after a failure the interpreter must not try again."""
    try:
        if sys.stdout is not None:
            sys.stdout.flush()
    except OSError as error:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        if isinstance(error, BrokenPipeError):
            return status
        os.write(2, f"error: standard output: {error.strerror}\n".encode())
        return 1
    return status


if __name__ == "__main__":
    sys.exit(main())
