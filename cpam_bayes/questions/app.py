"""The question `app`: a local page with a plate, its frequencies, and live results while the user types.

The page's results come from the functions behind the commands, run in separate processes.
"""

from __future__ import annotations

import tomllib
import webbrowser
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any, ClassVar, Final

import numpy as np

from cpam_bayes import __version__
from cpam_bayes.answer import Constant, FrequencyRow
from cpam_bayes.command import Command, option, whole
from cpam_bayes.diagnosis.hypotheses import NONE, OTHER
from cpam_bayes.errors import checked
from cpam_bayes.forward_model.build import Neighbour
from cpam_bayes.forward_model.known_errors import TolerantModel
from cpam_bayes.forward_model.model import with_references
from cpam_bayes.forward_model.preconditions import misfit_over_noise
from cpam_bayes.forward_model.reduced import ReducedModel
from cpam_bayes.identification.point import bound_of, verdict_of
from cpam_bayes.identification.search import posterior
from cpam_bayes.inference.laplace import POLISHED, find_optima
from cpam_bayes.inference.posterior import gauss_newton_covariance
from cpam_bayes.plate import Specimen, builtin_names, parse_specimen, to_user
from cpam_bayes.plate.reader import builtin_text
from cpam_bayes.questions.batch import batch
from cpam_bayes.questions.diagnose import diagnose
from cpam_bayes.questions.diagnose.document import (
    DiagnosisResult,
    answer_constants,
    place_of,
    probability_text,
    size_text,
    title_of,
)
from cpam_bayes.questions.forward import handling_before
from cpam_bayes.questions.identify import PointResult, answered
from cpam_bayes.questions.new import MATERIALS, KnownPlate, material_lines, plate_file_text
from cpam_bayes.questions.poles import poles
from cpam_bayes.questions.report import report
from cpam_bayes.render.files import save_tables
from cpam_bayes.render.page import PAGE
from cpam_bayes.render.report import Report, Summary
from cpam_bayes.render.sentences import determined_text, frequency_columns, interval_text, value_text
from cpam_bayes.render.spectrum import line_sizes
from cpam_bayes.result import Result, present
from cpam_bayes.workbench.worker import Shown, Tell

_PORT: Final = 8377
_REACH: Final = 1.959963984540054
# Seconds that the live answer to an earlier edit may delay that to the latest one.
_PATIENCE: Final = 3.0
# Causes shown as bars.
_BARS: Final = 8
# Points of a plotted spectrum.
_LINES: Final = 800
# Grid points per side of a thumbnail mode shape.
_GRID: Final = 13


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class AppResult(Result):
    """A page that was served and has ended."""

    command: ClassVar[str] = "app"

    address: str
    folder: Path


@present.register
def _present(result: AppResult) -> Report:
    return Report(
        summary=Summary(
            title="app",
            headline="The page is closed; nothing is lost.",
            lines=(f"Plate files and unsaved work are in {result.folder}.",),
        ),
        document={
            "command": result.command,
            "version": __version__,
            "address": result.address,
            "folder": str(result.folder),
        },
    )


@checked
def app(
    plate: str = ".",
    *,
    port: int = _PORT,
    no_browser: bool = False,
    announce: Callable[[str], None] = lambda address: print(address, flush=True),
) -> AppResult:
    """Serve the page of a plate, or of the plates of a folder, on this machine until Ctrl-C.

    Parameters
    ----------
    plate : a folder, a plate file, whose folder the page then serves, or a built-in specimen
    port : of 127.0.0.1; 0 for any free one
    no_browser : do not open a browser
    announce : called with the address of the page, token included

    Raises
    ------
    ValueError
        If the folder or plate does not exist, the port is taken, or the extra `app` is not installed.

    Examples
    --------
    >>> import cpam_bayes as cb
    >>> cb.app("no_such_plate.toml")
    Traceback (most recent call last):
    ValueError: app: received 'no_such_plate.toml', accepted: a folder, a plate file or a built-in specimen
    """
    try:
        from cpam_bayes.workbench import server
    except ModuleNotFoundError as error:
        raise ValueError(
            f"app: the page needs {error.name}, which is not installed; "
            'python -m pip install "cpam-bayes[app]"'
        ) from None
    from cpam_bayes.workbench.visit import Desk, Material, Tasks, Visit
    from cpam_bayes.workbench.worker import Pool, Worker

    folder, name, text = _place(plate)
    where = server.free_port(port)
    desk = Desk(
        folder=folder,
        tasks=Tasks(live, held, identified, diagnosed, picked, reported, listed),
        materials={key: Material(m.name, *material_lines(m)) for key, m in MATERIALS.items()},
        blank=plate_file_text(KnownPlate("plate", edges="FFFF", layup="[0_8]", is_typical=True)),
        example=(Path(server.__file__).parent / "pages" / "example.toml").read_text("utf-8"),
        live=Worker(patience=_PATIENCE),
        pool=Pool(2),
    )
    first = None if name is None else lambda: Visit.opened(desk, name, text)
    told: list[str] = []

    def ready(address: str) -> None:
        told.append(address)
        announce(address)
        if not no_browser:
            webbrowser.open(address)

    server.serve(desk, where, ready, first)
    return AppResult(seed=0, address=next(iter(told), "").partition("?")[0], folder=folder)


def _place(plate: str) -> tuple[Path, str | None, str | None]:
    """Folder, name of the plate file, and for a built-in specimen its text."""
    if plate in builtin_names():
        return Path.cwd(), f"{plate.replace('&', '_and_')}.toml", builtin_text(plate)
    path = Path(plate)
    if path.is_dir():
        return path.resolve(), None, None
    if not path.is_file():
        raise ValueError(
            f"app: received {plate!r:.80}, accepted: a folder, a plate file or a built-in specimen"
        )
    return path.resolve().parent, path.name, None


# Computations of the page, in other processes: plain data in and out.


@lru_cache(maxsize=4)
def _target(text: str, name: str, folder: str) -> tuple[Specimen, Any]:
    specimen = with_references(parse_specimen(text, name, Path(folder)))
    near = _converged[0] if _converged else None
    target = posterior(specimen, near=near)
    exact = target.model.model if isinstance(target.model, TolerantModel) else target.model
    assert isinstance(exact, ReducedModel)
    model = exact.full
    if near is None or not near.suits(specimen, model.parameters, model.n_modes):
        _converged[:] = [Neighbour(specimen, model)]
    return specimen, target


# The last converged plate: its trial functions are reused while a size is typed.
_converged: list[Neighbour] = []


def live(text: str, name: str, folder: str, optimum: Mapping[str, float] | None, *, tell: Tell) -> Any:
    """The constants by Laplace's approximation about the optimum nearest the last one.

    Shown during typing; `identified` replaces it at rest.
    """
    del tell
    specimen, target = _target(text, name, folder)
    names, scores = target.parameters.names, target.scores
    if optimum is not None and set(optimum) == set(names):
        last = scores.to_z(np.array([[optimum[n] for n in names]]))
        found = find_optima(target, last, log2_draws=0, settings=POLISHED)
    else:
        found = find_optima(target, np.empty((0, len(names))), settings=POLISHED)
    x = scores.to_x(found.z[0])
    measured = target.measurement.frequencies
    n = len(target.model.parameters.names)
    predicted = target.model.predict(x[None, :n]).frequencies[0]
    nearest = np.abs(np.log(predicted[:, None] / measured)).argmin(axis=0)
    predicted = predicted[: len(measured)] if target.measurement.complete else predicted[nearest]
    excess = misfit_over_noise(target.measurement, predicted / measured - 1.0, specimen.unknowns.size)
    sd = excess * np.sqrt(np.diag(gauss_newton_covariance(target, x)))
    constants = []
    for unknown in specimen.unknowns.names:
        i, prior = names.index(unknown), specimen.unknowns[unknown].prior
        value, spread = float(x[i]), float(sd[i])
        bound = bound_of(value, prior.lower, prior.upper)
        ends = (max(value - _REACH * spread, prior.lower), min(value + _REACH * spread, prior.upper))
        reference = float(specimen.material.complete()[unknown])
        verdict = verdict_of(spread, prior.sd, explained=excess == 1.0, at_bound=bound is not None)
        constants.append(
            Constant(unknown, value, spread, None if bound else ends, prior, reference, verdict, bound)
        )
    rows = [FrequencyRow(float(f), float(p)) for f, p in zip(measured, predicted, strict=True)]
    return {
        "constants": _constants(constants),
        "rows": _rows(rows),
        "rms": 100.0 * float(np.sqrt(np.mean((predicted / measured - 1.0) ** 2))),
        "optimum": dict(zip(names, x.tolist(), strict=True)),
    }


def held(text: str, name: str, folder: str, *, tell: Tell) -> Any:
    """Where to hold and hit a plate to be measured; None where other entries are missing."""
    del name, folder, tell
    handling = handling_before(tomllib.loads(text))
    return None if handling is None else {"said": handling.sentence, **handling.keys}


def identified(text: str, name: str, folder: str, *, tell: Tell) -> Any:
    """The answer of ``cpam-bayes identify`` as on its screen.

    For a list with rows left out by hand, the constants from all rows too.
    """
    specimen = parse_specimen(text, name, Path(folder))
    result = answered(specimen, watch=Shown(tell))
    whole = None if specimen.measurement is None else specimen.measurement.whole
    of_all = None
    if whole is not None:
        of_all = answered(replace(specimen, measurement=whole), watch=Shown(tell))
    shapes, modes = (
        (result.estimate.shapes, result.estimate.predicted)
        if isinstance(result, PointResult)
        else (result.shapes, result.modes)
    )
    percent = [100.0 * r.residual for r in result.frequencies if r.residual is not None]
    summary = result.report().summary
    return {
        "headline": summary.headline,
        "slips": list(summary.slips),
        "lines": list(summary.lines),
        "warnings": list(summary.warnings),
        "constants": _constants([*result.constants.values()]),
        "all_rows": None if of_all is None else _constants([*of_all.constants.values()]),
        "rows": _rows(result.frequencies),
        "rms": float(np.sqrt(np.mean(np.square(percent)))),
        "shapes": [
            _small(shapes[r.number - 1], modes[r.number - 1].in_plane_fraction > 0.5) if r.number else None
            for r in result.frequencies
        ],
    }


def diagnosed(text: str, name: str, folder: str, *, tell: Tell) -> Any:
    """The answer of ``cpam-bayes diagnose``, with causes as bars and the part that a plate file can state."""
    specimen = parse_specimen(text, name, Path(folder))
    result = diagnose(specimen, next_test="never", watch=Shown(tell))
    d, summary = result.diagnosis, result.report().summary
    apply, said = _applied(result, specimen)
    first = next((c for c in d.causes if c.name not in (NONE, OTHER)), None)
    place = place_of(first, specimen.plate) if first is not None and first.name in d.claim.causes else None
    return {
        "claim": summary.headline,
        "kind": d.claim.kind,
        "slips": list(summary.slips),
        "lines": list(summary.lines),
        "next": summary.next_step,
        "constants": _constants(answer_constants(d)),
        "rows": _rows(
            [FrequencyRow(r.measured, r.predicted) for r in (result.extended or result.plain).frequencies]
        ),
        "causes": [
            {
                "title": title_of(d, c.name),
                "probability": c.probability,
                "said": probability_text(c.probability),
            }
            for c in d.causes[:_BARS]
        ],
        "nothing": 1.0 - d.something_wrong,
        "place": None if place is None else [[1e3 * v for v in part] for part in place],
        "apply": apply,
        "apply_said": said,
    }


def _applied(result: DiagnosisResult, specimen: Specimen) -> tuple[Any, str]:
    """The claimed cause as an entry of a plate file, and in words; None where no key exists for it."""
    d = result.diagnosis
    if d.claim.kind != "named":
        return None, ""
    cause = next(c for c in d.causes if c.name == d.claim.causes[0])
    place = place_of(cause, specimen.plate)
    effect = next(iter(cause.hypothesis.effects), None)
    if effect is not None and effect.local == "point" and place is not None:
        mass = to_user("mass", cause.parameters[effect.parameters[0].name][0])
        x, y = (1e3 * v for v in place[0])
        return (
            {"sensor": {"mass_g": f"{mass:.2f}", "x_mm": f"{x:.0f}", "y_mm": f"{y:.0f}"}},
            f"state {mass:.2f} g at ({x:.0f}, {y:.0f}) mm as a mass on the plate",
        )
    if cause.name in ("thickness", "length", "width"):
        relative = cause.parameters[f"{cause.name}_deviation"][0]
        value = to_user(cause.name, getattr(specimen.plate, cause.name) * (1.0 + relative))
        return (
            {"key": f"plate.{cause.name}_mm", "value": f"{value:.5g}"},
            f"state a {cause.name} of {value:.5g} mm ({size_text(cause)})",
        )
    return None, ""


def reported(text: str, name: str, folder: str, *, tell: Tell) -> Any:
    """Paths of the files of ``cpam-bayes report --quick``, in a folder named after the plate file."""
    answer = report(parse_specimen(text, name, Path(folder)), quick=True, watch=Shown(tell))
    target = _saved(answer, folder, f"{Path(name).stem}-report", "report.xlsx")
    files = {"page": PAGE, "json": "report.json", "xlsx": "report.xlsx"}
    return {kind: f"{target}/{file}" for kind, file in files.items()}


def _saved(answer: Result, folder: str, name: str, workbook: str) -> str:
    """Write the files of an answer to a folder beside the plate files; returns its name."""
    target = Path(folder) / name
    if target.is_symlink():
        raise ValueError(f"{name}: a link, accepted: a folder of this page")
    answer.save(target)
    save_tables(answer, None, str(target / workbook))
    return name


def picked(text: str, name: str, folder: str, recording: str, *, tell: Tell) -> Any:
    """The modes, Hz, that ``cpam-bayes poles`` picks from a recording, and its spectrum.

    Their standard deviations are of one recording, not of the test, and are left to the command.
    """
    del text, name
    result = poles(Path(folder) / recording, watch=Shown(tell))
    hz, size = line_sizes(result.test, result.test.responses.frf)
    parts = np.array_split(np.arange(len(size)), min(len(size), _LINES))
    peaks = [part[int(np.argmax(size[part]))] for part in parts]
    level = 20.0 * np.log10(np.maximum(size, 1e-6 * size.max()) / size.max())
    return {
        "recording": recording,
        "modes": [float(f"{m.frequency:.5g}") for m in result.modes],
        "spectrum": [[round(float(hz[i]), 3), round(float(level[i]), 1)] for i in peaks],
    }


def listed(text: str, name: str, folder: str, *, tell: Tell) -> Any:
    """The table of ``cpam-bayes batch`` over plate files of a folder; text : their names, one per line."""
    del name
    files = text.split("\n")
    result = batch(*(str(Path(folder) / file) for file in files), watch=Shown(tell))
    report = result.report()
    target = _saved(result, folder, "batch", "results.xlsx")
    table = report.rows[0].table("")
    return {
        "headline": report.summary.headline,
        "heads": [[h.text, h.number] for h in table.columns],
        "rows": [
            {"file": file, "cells": list(cells), "why": row.message if row.status == "failed" else ""}
            for file, cells, row in zip(files, table.rows, result.rows, strict=True)
        ],
        "lines": [*report.summary.lines, *report.summary.warnings],
        "page": f"{target}/{PAGE}",
    }


def _constants(constants: Sequence[Constant]) -> list[dict[str, Any]]:
    """Constants as on the screen, and their numbers in plate-file units."""
    found = []
    for c in constants:
        interval = None if c.interval is None else [to_user(c.name, end) for end in c.interval]
        found.append(
            {
                "name": c.name,
                "value": to_user(c.name, c.value),
                "interval": interval,
                "bounds": [to_user(c.name, c.prior.lower), to_user(c.name, c.prior.upper)],
                "reference": to_user(c.name, c.reference),
                "is_determined": c.is_determined,
                "words": [value_text(c), interval_text(c), determined_text(c)],
            }
        )
    return found


def _rows(rows: Sequence[FrequencyRow]) -> list[dict[str, Any]]:
    columns = {c.key: c for c in frequency_columns(rows) if c.key is not None}
    return [
        {
            "model": columns["predicted_hz"].cell(row),
            "residual": columns["residual_percent"].cell(row),
            "percent": None if row.residual is None else 100.0 * row.residual,
        }
        for row in rows
    ]


def _small(shape: Any, in_plane: bool) -> list[list[int]]:
    """A mode shape (3, n, n) on a coarse grid, integers from -3 to 3; in-plane: the larger of u and v."""
    fields = np.asarray(shape)
    field = max(fields[:2], key=lambda f: float(np.abs(f).max())) if in_plane else fields[2]
    pick = np.linspace(0, field.shape[0] - 1, _GRID).round().astype(int)
    coarse = field[np.ix_(pick, pick)]
    scaled = coarse / max(float(np.abs(coarse).max()), 1e-300)
    return [[int(v) for v in line] for line in np.rint(3.0 * scaled)]


COMMAND: Final = Command(
    app,
    (
        option(
            "plate",
            nargs="?",
            default=".",
            metavar="PLATE|DIR",
            help="a plate file, a folder of plate files, or a built-in specimen (default: this folder)",
        ),
        option(
            "--port",
            type=whole(0, 65535),
            default=_PORT,
            metavar="N",
            help=f"port of 127.0.0.1, 0 for any free one (default: {_PORT})",
        ),
        option("--no-browser", action="store_true", help="do not open a browser"),
    ),
    out=None,
    watched=False,
    seeded=False,
)
