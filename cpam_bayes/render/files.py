"""Result files: written to a draft beside their place, and moved there when complete."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any, ClassVar, Protocol

from cpam_bayes.plate import Specimen
from cpam_bayes.render.page import PAGE, command_of, write_page
from cpam_bayes.render.report import Report, csv_text, json_text, xlsx_bytes
from cpam_bayes.storage import draft_directory, put_in_place, replaceable, write_whole

_FIGURES = "figures"
_DRAWS = "posterior.nc"

# Final directory of the files, and the draft directory.
Stage = tuple[Path, Path]


class _Answer(Protocol):
    """The result of a question as it is saved, see `cpam_bayes.result.Result`."""

    command: ClassVar[str]

    @property
    def seed(self) -> int: ...

    @property
    def title(self) -> str: ...

    @property
    def about(self) -> tuple[Specimen, ...]: ...

    @property
    def has_draws(self) -> bool: ...
    def report(self) -> Report: ...
    def saved_report(self) -> Report: ...
    def to_arviz(self) -> Any: ...
    def texts(self) -> Mapping[str, str]: ...
    def datasets(self) -> Mapping[str, Any]: ...


@contextmanager
def staging(out: str | None) -> Iterator[Stage | None]:
    """Make the directory and its draft before any work; leave nothing behind if the work fails.

    Raises ``ValueError`` if `out` cannot be made or written to.
    """
    if out is None:
        yield None
        return
    if not out:
        raise ValueError("--out: received an empty name, accepted: a directory")
    directory = Path(out)
    made = _made(directory)
    with ExitStack() as stack:
        stack.callback(_remove_empty, made)
        yield directory, _draft(directory, stack)


def save(result: _Answer, stage: Stage | None) -> tuple[str, ...]:
    """Write NAME.json, the figures as PNG and SVG, other files; raise ``OSError`` where that fails.

    Returns a sentence for each file of another command that was renamed.
    """
    if stage is None:
        return ()
    directory, draft = stage
    # The answer goes to its place first: it took longest, and survives whatever fails afterwards.
    report = result.saved_report()
    (draft / f"{result.command}.json").write_text(json_text(report.document), encoding="utf-8")
    _moved(draft, directory)
    for name, text in result.texts().items():
        (draft / name).write_bytes(_encoded(text, name))
    for name, dataset in result.datasets().items():
        dataset.to_netcdf(draft / name, engine="h5netcdf")
    notes = _draws_written(result, draft, directory) if result.has_draws else ()
    _moved(draft, directory)
    if report.drawings:
        from cpam_bayes.render.figures import save_figures

        (draft / _FIGURES).mkdir()
        save_figures({d.name: d.draw() for d in report.drawings}, draft / _FIGURES)
    write_page(report, draft, result.command, result.title, result.seed, result.about)
    notes += _other_kept(directory / PAGE, "page.html", result.command, command_of)
    _moved(draft, directory)
    return notes


def require_table(path: str | None, ending: str) -> None:
    """Raise ``ValueError``, before any work, for a table file that cannot be written."""
    if path is None:
        return
    file = Path(path)
    if file.suffix.casefold() != f".{ending}":
        raise ValueError(f"--{ending}: received {path!r}, accepted: a file that ends in .{ending}")
    if not file.parent.is_dir() or not replaceable(file):
        raise ValueError(
            f"--{ending} {path}: cannot be written to, accepted: a file in an existing directory"
        )


def save_tables(result: _Answer, csv: str | None, xlsx: str | None) -> None:
    """Write the main table as CSV and all tables as a workbook; raise ``OSError`` where that fails."""
    if csv is None and xlsx is None:
        return
    tables = result.report().written
    if csv is not None:
        write_whole(Path(csv), _encoded(csv_text(tables[0]), csv))
    if xlsx is not None:
        write_whole(Path(xlsx), xlsx_bytes(tables))


def _encoded(text: str, name: str) -> bytes:
    """A text as bytes of its file; CSV gets a byte order mark, by which Excel recognises UTF-8."""
    return text.encode("utf-8-sig" if name.casefold().endswith(".csv") else "utf-8")


def _draws_written(result: _Answer, draft: Path, directory: Path) -> tuple[str, ...]:
    """Write the draws; returns sentences on renamed draws of another command."""
    from cpam_bayes.inference.sampling import command_of_draws

    result.to_arviz().to_netcdf(str(draft / _DRAWS))
    # draws of `report` are those of `identify`
    command = command_of_draws(draft / _DRAWS) or result.command
    return _other_kept(directory / _DRAWS, _DRAWS, command, command_of_draws)


def _other_kept(
    file: Path, name: str, command: str, command_of_file: Callable[[Path], str | None]
) -> tuple[str, ...]:
    """Rename a file of another command to COMMAND_NAME, and delete an older one of this command."""
    file.with_name(f"{command}_{name}").unlink(missing_ok=True)
    other = command_of_file(file) if file.is_file() else None
    if other is None or other == command:
        return ()
    kept = file.with_name(f"{other}_{name}")
    put_in_place(file, kept)
    return (f"{file} is now from {command}; that from {other} is kept as {kept.name}",)


def _moved(draft: Path, directory: Path) -> None:
    written = sorted(path for path in draft.rglob("*") if path.is_file())
    for path in written:
        target = directory / path.relative_to(draft)
        target.parent.mkdir(exist_ok=True)
        put_in_place(path, target)


def _made(directory: Path) -> list[Path]:
    """Make a directory; returns the directories created, the innermost first."""
    try:
        missing = [path for path in (directory, *directory.parents) if not os.path.lexists(path)]
        directory.mkdir(parents=True, exist_ok=True)
    except FileExistsError:
        raise ValueError(f"--out {directory}: a file, accepted: a directory") from None
    except (OSError, ValueError) as error:
        raise _refused(directory, error) from None
    return missing


def _draft(directory: Path, stack: ExitStack) -> Path:
    figures = directory / _FIGURES
    try:
        if figures.exists() and not (figures.is_dir() and os.access(figures, os.W_OK | os.X_OK)):
            raise ValueError(f"--out {directory}: {figures} is not a writable directory")
        return stack.enter_context(draft_directory(directory))
    except OSError as error:
        raise _refused(directory, error) from None


def _refused(directory: Path, error: Exception) -> ValueError:
    reason = error.strerror if isinstance(error, OSError) else str(error)
    return ValueError(f"--out {directory}: cannot be written to: {reason}")


def _remove_empty(made: list[Path]) -> None:
    for path in made:
        with suppress(OSError):
            path.rmdir()
