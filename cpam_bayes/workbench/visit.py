"""A visit: one plate file on one page, with its undo, its draft on disk, and the computations after edits."""

from __future__ import annotations

import asyncio
import json
import os
import re
import secrets
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final

from cpam_bayes.errors import PlateFileError
from cpam_bayes.plate import MAX_BYTES, Specimen, parse_specimen
from cpam_bayes.plate.checks import SOURCES
from cpam_bayes.plate.text import decode, read_regular_file
from cpam_bayes.storage import replaceable, write_whole
from cpam_bayes.workbench.plate_text import (
    FIELDS,
    SENSOR,
    Row,
    content,
    numbers_in,
    rows_in,
    sensors_in,
    value_at,
    with_block,
    with_file,
    with_rows,
    with_sensors,
    with_value,
)
from cpam_bayes.workbench.worker import Pool, RefusedError, Task, Worker

DRAFTS: Final = ".cpam-bayes"
"""Folder of unsaved work beside the plate files."""
_NAME: Final = re.compile(r"[A-Za-z0-9][A-Za-z0-9 ._+&-]{0,79}\.toml")
_VISIT: Final = re.compile(r"[0-9a-f]{16}")
_MOST_TYPED, _MOST_UNDO, _MOST_DRAFTS, _MOST_LISTED = 20_000, 100, 50, 200
# Edits of one field within this many seconds are one step of undo.
_ONE_EDIT: Final = 3.0
LIST_FILES: Final = ("measurement.picked_from", *(f"measurement.{key}" for key in SOURCES[1:]))
"""Keys of a plate file that name the file of its list."""
# All keys that name another file.
_PATHS: Final = ("plate.mesh", "material.posterior", *LIST_FILES)
_EDGES: Final = "FSC"
_DROPPED: Final = re.compile(
    r"[A-Za-z0-9][A-Za-z0-9 ._+&()-]{0,79}\.(csv|txt|xlsx|unv|uff|wav)", re.IGNORECASE
)
MOST_BYTES: Final = 32_000_000
"""Largest size of a dropped file."""
# A click on a spectrum selects the listed frequency, or else the highest line, within this fraction.
_AT: Final = 0.008


class EditError(ValueError):
    """A refused edit; nothing is changed."""


@dataclass(frozen=True, slots=True)
class Material:
    """A typical material: the lines of [material] and [unknowns]."""

    title: str
    constants: tuple[str, ...]
    unknowns: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Tasks:
    """Computations on a plate file, called with its text, name and folder.

    live : answer about the last optimum, its fourth argument
    hold : where to hold and hit a plate without measurement
    identify, diagnose, report : as the commands; report writes its folder
    pick : modes and spectrum of a recording, its fourth argument
    batch : table of several plate files, whose names are the text
    """

    live: Task
    hold: Task
    identify: Task
    diagnose: Task
    pick: Task
    report: Task
    batch: Task


@dataclass(frozen=True, slots=True)
class Desk:
    """State shared by all visits.

    folder : of the plate files; nothing outside it is read or written
    blank : text of an empty plate file; example : text of an example
    rest : seconds without an edit after which the long computations begin
    """

    folder: Path
    tasks: Tasks
    materials: Mapping[str, Material]
    blank: str
    example: str
    live: Worker
    pool: Pool
    rest: float = 0.7


def plate_names(folder: Path) -> list[str]:
    """Names of the plate files that the page can open."""
    found = (
        p.name for p in folder.iterdir() if _NAME.fullmatch(p.name) and p.is_file() and not p.is_symlink()
    )
    return sorted(found)[:_MOST_LISTED]


def _require_name(name: object) -> str:
    if not isinstance(name, str) or not _NAME.fullmatch(name):
        raise EditError(
            f"file: received {name!r:.60}, accepted: a name of letters, digits, spaces and ._+&- "
            "that ends in .toml"
        )
    return name


@dataclass(slots=True, kw_only=True)
class Work:
    """The running computation of a page, and the requests waiting for its news.

    file, text : arguments of the tasks
    answers : of the tasks, by name, for the current text
    doing : the task, the fraction done, negative if unknown, and its stage
    shares : probabilities so far of what is compared
    """

    desk: Desk
    file: str = ""
    text: str = ""
    version: int = 1
    answers: dict[str, Any] = field(default_factory=dict)
    problems: tuple[str, ...] = ()
    doing: tuple[str, float, str] = ("", -1.0, "")
    shares: Mapping[str, float] = field(default_factory=dict)
    _work: asyncio.Task[None] | None = None
    _changed: asyncio.Event = field(default_factory=asyncio.Event)

    def stop(self) -> None:
        """End the running computation."""
        work, self._work = self._work, None
        if work is not None:
            work.cancel()
        self.doing = ("", -1.0, "")

    def cancel(self) -> None:
        """End the running computation on the user's request."""
        self.stop()
        self.tell()

    def begin_task(self, task: str, *more: Any) -> None:
        """Start a task in place of the running computation."""
        self.stop()
        self._work = asyncio.get_running_loop().create_task(self._asked(task, *more))
        self.tell()

    async def _asked(self, task: str, *more: Any) -> None:
        with suppress(RefusedError):
            await self._long(task, *more)

    async def _long(self, task: str, *more: Any) -> None:
        def tell(done: float, text: str, shares: Mapping[str, float] | None = None) -> None:
            self.shares = self.shares if shares is None else shares
            self.doing = (task, done if done >= 0.0 else self.doing[1], text)
            self.tell()

        self.doing, self.shares = (task, -1.0, ""), {}
        self.tell()
        try:
            async with self.desk.pool.worker() as worker:
                work, folder = getattr(self.desk.tasks, task), str(self.desk.folder)
                found = await worker.run(work, self.text, self.file, folder, *more, tell=tell)
            self.answers[task] = found
        except RefusedError as error:
            self.problems = error.args
            raise
        finally:
            if self.doing[0] == task:
                self.doing = ("", -1.0, "")
        self.tell()

    def tell(self) -> None:
        """Wake the requests waiting for news."""
        self.version += 1
        self._changed.set()
        self._changed = asyncio.Event()

    async def news(self, seen: int, seconds: float) -> None:
        """Return when the version differs from the one seen, or after some seconds."""
        if self.version != seen:
            return
        changed = self._changed
        with suppress(TimeoutError):
            await asyncio.wait_for(changed.wait(), seconds)


@dataclass(slots=True, kw_only=True)
class Visit(Work):
    """One plate file on one page.

    key : identifies the visit in addresses
    file : name of the plate file in the folder; saved : its text on disk, None if not saved yet
    structure : number of edits that required a new form
    stale : last answers to an earlier text, and the spectrum of the recording
    dropped : recording that is searched for modes
    """

    key: str
    saved: str | None = None
    undone: list[str] = field(default_factory=list)
    before: list[str] = field(default_factory=list)
    structure: int = 1
    stale: dict[str, Any] = field(default_factory=dict)
    fields: dict[str, str] = field(default_factory=dict)
    gaps: tuple[str, ...] = ()
    others: tuple[str, ...] = ()
    specimen: Specimen | None = None
    dropped: str = ""
    _last: tuple[str, float] = ("", 0.0)

    @classmethod
    def opened(cls, desk: Desk, name: str | None, text: str | None = None) -> Visit:
        """A visit of a file of the folder, or of an unsaved text; raises ``EditError``."""
        key = secrets.token_hex(8)
        if text is not None:
            return cls(desk=desk, key=key, file=_free_name(desk.folder, name or "plate.toml"), text=text)
        path = desk.folder / _require_name(name)
        if not replaceable(path):
            raise EditError(f"{name}: a link or no file, accepted: a plate file of the folder")
        try:
            found = decode(read_regular_file(str(path), path.name, "a plate file"), path.name)
        except (OSError, PlateFileError) as error:
            raise EditError(str(error) or f"{name}: cannot be read") from None
        return cls(desk=desk, key=key, file=path.name, text=found, saved=found)

    @classmethod
    def restored(cls, desk: Desk, key: str) -> Visit:
        """A visit restored from its draft; raises ``EditError`` where there is none."""
        if not _VISIT.fullmatch(key):
            raise EditError("no such visit")
        try:
            kept = json.loads((desk.folder / DRAFTS / f"{key}.json").read_text("utf-8"))
            file, text, saved, before = (kept[k] for k in ("file", "text", "saved", "before"))
            if not isinstance(text, str) or not all(isinstance(t, str) for t in before):
                raise TypeError
            name = _require_name(file)
            return cls(desk=desk, key=key, file=name, text=text, saved=saved, before=before)
        except (OSError, ValueError, KeyError, TypeError):
            raise EditError("this visit has expired; open the plate again") from None

    @property
    def data(self) -> dict[str, Any]:
        """Values of the plate file."""
        return content(self.text)

    @property
    def edges(self) -> str:
        """The four edge letters; FFFF where the text has no readable ones."""
        if self.specimen is not None:
            return self.specimen.plate.edges
        given = value_at(self.data, "plate.edges")
        return given if isinstance(given, str) and len(given) == 4 and set(given) <= set(_EDGES) else "FFFF"

    def edit(self, change: Mapping[str, Any]) -> None:
        """Make one edit and start the computations after it; raises ``EditError``."""
        what = change.get("do")
        if what == "undo" or what == "redo":
            source, other = (self.before, self.undone) if what == "undo" else (self.undone, self.before)
            if not source:
                return
            other.append(self.text)
            self._become(source.pop(), anew=True)
            return
        text = _edited(self, what, change)
        if len(text.encode()) > MAX_BYTES:
            raise EditError(f"the plate file: too large, accepted: up to {MAX_BYTES} bytes")
        if text == self.text:
            return
        field_name, now = f"{what} {change.get('key')} {change.get('index')}", time.monotonic()
        is_step = self._last[0] != field_name or now - self._last[1] > _ONE_EDIT or not self.before
        self._last = (field_name, now)
        before, after = ([(r.left_out, r.by_hand) for r in rows_in(content(t))] for t in (self.text, text))
        self.undone = []
        self._become(text, anew=what not in ("set", "row") or before != after, is_step=is_step)

    @property
    def rows(self) -> list[Row]:
        """Rows of the list, from the plate file or from the file that it names."""
        measurement = self.specimen.measurement if self.specimen is not None else None
        if measurement is None or value_at(self.data, "measurement.frequencies_hz") is not None:
            return rows_in(self.data)
        whole = measurement.whole or measurement
        out = value_at(self.data, "measurement.left_out") or []
        return [Row(f"{f:.10g}", left_out=i in out) for i, f in enumerate(whole.frequencies, 1)]

    def take(self, name: str, content_of: bytes) -> str:
        """Save a dropped file in the folder and use its frequencies; raises ``EditError``.

        A table or universal file is named in the plate file; the modes of a recording become its list.
        """
        if not _DROPPED.fullmatch(name):
            accepted = "a file .csv .txt .xlsx .unv .uff or .wav whose name has letters, digits and ._+&()-"
            raise EditError(f"file: received {name!r:.60}, accepted: {accepted}")
        path = self.desk.folder / name
        if os.path.lexists(path) and not (replaceable(path) and path.read_bytes() == content_of):
            raise EditError(f"{name}: another file of that name is in the folder; give it another name")
        ending = path.suffix.lower()
        key = {".wav": "", ".unv": "shapes", ".uff": "shapes"}.get(ending, "table")
        is_new = not path.exists()
        write_whole(path, content_of)
        if not key:
            self.dropped = name
            self.stale.pop("pick", None)
            self.begin()
            return f"looking for modes in {name}"
        text = with_file(self.text, key, name)
        try:
            parse_specimen(text, self.file, self.desk.folder)
        except PlateFileError as error:
            wrong = [p for p, where, _ in error.found if where[:1] == ("measurement",)]
            if wrong:
                if is_new:
                    path.unlink()
                raise EditError("; ".join(wrong[:3])) from None
        self._become(text, anew=True, is_step=True)
        return f"frequencies from {name}"

    async def _picked(self) -> None:
        """Compute the spectrum of the recording; the modes of a newly dropped one become the list."""
        name = self.dropped or value_at(self.data, "measurement.picked_from")
        if not isinstance(name, str) or (self.stale.get("pick") or {}).get("recording") == name:
            return
        is_new = bool(self.dropped)
        try:
            await self._long("pick", name)
        except RefusedError:
            self.dropped = ""
            raise
        self.stale["pick"], self.dropped = self.answers.pop("pick"), ""
        if is_new:
            picked = [Row(repr(hz)) for hz in self.stale["pick"]["modes"]]
            text = with_file(self.text, "picked_from", name)
            self._become(with_rows(text, picked), anew=True, is_step=True)
        self.tell()

    def cancel(self) -> None:
        """End the running computation on the user's request."""
        self.dropped = ""
        Work.cancel(self)

    def _become(self, text: str, *, anew: bool, is_step: bool = False) -> None:
        if is_step:
            self.before, self.undone = [*self.before, self.text][-_MOST_UNDO:], []
        self.text = text
        self.structure += anew
        self.keep()
        self.begin()

    def begin(self) -> None:
        """Check the text, and start its computations in place of the running one."""
        self.stop()
        shown = self.answers.get("identify") or self.answers.get("live") or self.stale.get("shown")
        self.stale = {**self.stale, **self.answers, "shown": shown}
        self.answers = {}
        self._check()
        is_measured = self.specimen is not None and self.specimen.measurement is not None
        if is_measured or not self.others or self.dropped:
            work = self._answered() if is_measured else self._guided()
            self._work = asyncio.get_running_loop().create_task(work)
        self.tell()

    async def _guided(self) -> None:
        """Find where to hold and hit a plate without frequencies."""
        desk = self.desk
        with suppress(RefusedError):
            self.answers["hold"] = await desk.live.run(
                desk.tasks.hold, self.text, self.file, str(desk.folder)
            )
            self.tell()
        with suppress(RefusedError):
            await self._picked()

    def ask(self, task: str) -> None:
        """Compute one task again, or one that runs on request; raises ``EditError``."""
        if self.specimen is None or self.specimen.measurement is None:
            raise EditError("the plate file is not complete yet")
        self.begin_task(task)

    def _check(self) -> None:
        self.fields, self.problems, self.specimen = {}, (), None
        self.gaps = self.others = ()
        data = self.data
        for key in _PATHS:
            if not _inside(value_at(data, key)):
                self.others = (
                    f"{key}: received a path that leaves the folder, accepted: a file in the folder",
                )
                return
        try:
            self.specimen = parse_specimen(self.text, self.file, self.desk.folder)
        except PlateFileError as error:
            self.fields, gaps, others = {}, [], []
            for said, path, phrase in error.found:
                name = ".".join(str(part) for part in path[:2])
                if said in error.gaps:
                    gaps.append(f"{name}: {phrase}")
                elif name in FIELDS or path[:1] == ("sensor",):
                    whole = name == "measurement.frequencies_hz" or path[0] == "sensor"
                    self.fields.setdefault(".".join(map(str, path)) if whole else name, phrase)
                else:
                    others.append(said)
            self.gaps, self.others = tuple(gaps), tuple(others) or (() if error.found else error.problems)

    async def _answered(self) -> None:
        """Compute the live answer at once; after a rest that of the command, then the diagnosis."""
        desk = self.desk
        try:
            optimum = self.stale.get("optimum")
            live = await desk.live.run(desk.tasks.live, self.text, self.file, str(desk.folder), optimum)
            self.answers["live"] = live
            self.stale["optimum"] = live["optimum"]
            self.tell()
        except RefusedError as error:
            self.problems = error.args
            self.tell()
            return
        await asyncio.sleep(desk.rest)
        with suppress(RefusedError):
            await self._picked()
            await self._long("identify")
            await self._long("diagnose")

    def keep(self) -> None:
        """Write the draft, from which a reload or a new server restores the visit."""
        kept = {"file": self.file, "text": self.text, "saved": self.saved, "before": self.before[-20:]}
        folder = self.desk.folder / DRAFTS
        with suppress(OSError):  # a folder that cannot be written to: the page goes on without
            folder.mkdir(exist_ok=True)
            write_whole(folder / f"{self.key}.json", json.dumps(kept, ensure_ascii=False).encode())
            old = sorted(folder.glob("*.json"), key=os.path.getmtime)[:-_MOST_DRAFTS]
            for path in old:
                path.unlink()

    def save(self, name: object) -> str:
        """Save the plate file in the folder and return what was done; raises ``EditError``."""
        path = self.desk.folder / _require_name(name)
        if path.name != self.file and os.path.lexists(path):
            raise EditError(f"{path.name}: exists; give another name")
        if (
            self.saved is not None
            and path.name == self.file
            and path.exists()
            and path.read_text("utf-8") != self.saved
        ):
            raise EditError(f"{path.name}: was changed by another program; save under another name")
        try:
            write_whole(path, self.text.encode())
        except OSError as error:
            raise EditError(f"{path.name}: cannot be written to: {error.strerror}") from None
        self.file, self.saved = path.name, self.text
        self.keep()
        self.tell()
        return f"saved as {path.name}"


def _edited(visit: Visit, what: object, change: Mapping[str, Any]) -> str:
    """The text after an edit; raises ``EditError``."""
    text, data = visit.text, visit.data
    match what:
        case "set":
            key = change.get("key")
            if key not in FIELDS:
                raise EditError(f"key: received {key!r:.60}, accepted: a field of the page")
            return with_value(text, str(key), _typed(change.get("value")))
        case "edge":
            place, letter = change.get("index"), change.get("value")
            edges = list(visit.edges)
            if place not in (0, 1, 2, 3) or letter not in tuple(_EDGES):
                raise EditError(f"edge: received {letter!r:.60}, accepted: F S C at 0 to 3")
            edges[int(place)] = str(letter)
            return with_value(text, "plate.edges", "".join(edges))
        case "row" | "leave" | "peak":
            listed = value_at(data, "measurement.frequencies_hz") is not None or what != "leave"
            rows = rows_in(data) if listed else visit.rows
            return with_rows(text, _with_row(visit, rows, str(what), change), listed=listed)
        case "paste" | "append":
            numbers = numbers_in(_typed(change.get("value")))
            if not numbers:
                raise EditError("frequencies: no number pasted, accepted: a list in Hz")
            if what == "paste":
                return with_rows(with_file(text, "frequencies_hz", ""), [Row(hz) for hz in numbers])
            is_picked = value_at(data, "measurement.picked_from") is not None
            return with_rows(text, _sorted([*rows_in(data), *(Row(hz, by_hand=is_picked) for hz in numbers)]))
        case "material":
            material = visit.desk.materials.get(str(change.get("value")))
            if material is None:
                raise EditError(f"material: accepted: {' '.join(visit.desk.materials)}")
            return with_block(with_block(text, "material", material.constants), "unknowns", material.unknowns)
        case "sensor":
            return _with_sensor(text, data, change)
        case "apply":
            apply = visit.answers.get("diagnose", {}).get("apply")
            if not apply:
                raise EditError("there is nothing to apply")
            if "sensor" in apply:
                return with_sensors(text, [*sensors_in(data), apply["sensor"]])
            return with_value(text, apply["key"], apply["value"])
    raise EditError(
        f"do: received {what!r:.60}, accepted: set edge row leave peak paste append material sensor apply "
        "undo redo"
    )


def _with_row(visit: Visit, rows: list[Row], what: str, change: Mapping[str, Any]) -> list[Row]:
    """The rows after one was edited, switched, or added or left out by a click on the spectrum.

    Rows picked from a recording are left out, not deleted, so that the file records it.
    """
    is_picked = value_at(visit.data, "measurement.picked_from") is not None
    if what == "peak":
        hz = change.get("value")
        if isinstance(hz, bool) or not isinstance(hz, int | float) or not 0.0 < hz < 1e6:
            raise EditError(f"peak: received {hz!r:.60}, accepted: a frequency in Hz")
        near = [i for i, row in enumerate(rows) if abs(_hz(row) / hz - 1.0) < _AT]
        if not near:
            lines = (visit.stale.get("pick") or {}).get("spectrum", [])
            peak = max((p for p in lines if abs(p[0] / hz - 1.0) < _AT), key=lambda p: p[1], default=(hz,))[0]
            return _sorted([*rows, Row(f"{peak:.6g}", by_hand=True)])
        index = min(near, key=lambda i: abs(_hz(rows[i]) - hz))
        return _switched(rows, index, not rows[index].left_out)
    index = _index(change.get("index"), len(rows) + (what == "row"))
    if what == "leave":
        if not isinstance(change.get("value"), bool):
            raise EditError("leave: accepted: true or false")
        return _switched(rows, index, bool(change["value"]))
    typed = _typed(change.get("value")).strip()
    if index == len(rows):
        return [*rows, Row(typed, by_hand=is_picked)] if typed else rows
    if not typed:
        return _switched(rows, index, True) if is_picked else [*rows[:index], *rows[index + 1 :]]
    edited = replace(
        rows[index], hz=typed, by_hand=rows[index].by_hand or (is_picked and typed != rows[index].hz)
    )
    return [*rows[:index], edited, *rows[index + 1 :]]


def _switched(rows: list[Row], index: int, left_out: bool) -> list[Row]:
    """The rows with one left out or taken back; a row added by hand is removed instead."""
    if left_out and rows[index].by_hand:
        return [*rows[:index], *rows[index + 1 :]]
    return [*rows[:index], replace(rows[index], left_out=left_out), *rows[index + 1 :]]


def _hz(row: Row) -> float:
    try:
        return float(row.hz.replace(",", "."))
    except ValueError:
        return float("inf")


def _sorted(rows: list[Row]) -> list[Row]:
    return sorted(rows, key=_hz)


def _with_sensor(text: str, data: Mapping[str, Any], change: Mapping[str, Any]) -> str:
    sensors = sensors_in(data)
    index = _index(change.get("index"), len(sensors) + 1)
    value = change.get("value")
    if value is None:
        del sensors[index : index + 1]
    elif isinstance(value, Mapping) and set(value) <= set(SENSOR):
        old = sensors[index] if index < len(sensors) else {}
        sensors[index : index + 1] = [old | {k: _typed(v) for k, v in value.items()}]
    else:
        raise EditError(f"sensor: accepted: {' '.join(SENSOR)}")
    return with_sensors(text, sensors)


def _typed(value: object) -> str:
    if (
        not isinstance(value, str)
        or len(value) > _MOST_TYPED
        or not value.replace("\n", " ").replace("\t", " ").replace("\r", " ").isprintable()
    ):
        raise EditError(f"value: accepted: up to {_MOST_TYPED} printable characters")
    return value


def _index(value: object, most: int) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value < most:
        raise EditError(f"index: received {value!r:.60}, accepted: 0 to {most - 1}")
    return value


def _inside(value: object) -> bool:
    """Whether the paths under a key stay in the folder of the plate file."""
    names: Sequence[object] = value if isinstance(value, list) else [value]
    return all(
        not isinstance(name, str)
        or not (Path(name).is_absolute() or ".." in Path(name).parts or "\\" in name)
        for name in names
    )


def _free_name(folder: Path, name: str) -> str:
    """A file name not yet used in the folder."""
    stem = Path(name).stem
    for k in range(1, 1000):
        free = f"{stem}.toml" if k == 1 else f"{stem}-{k}.toml"
        if not os.path.lexists(folder / free):
            return free
    raise EditError(f"{folder.name}: too many files named {stem}")
