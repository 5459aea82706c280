"""Files of a modal test: frequency responses of analysers, or recorded hits.

Universal files with datasets 58, tables of responses, and .wav files.
"""

from __future__ import annotations

import hashlib
import io
import os
import re
import warnings
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy.io import wavfile

from cpam_bayes.answer import Notice
from cpam_bayes.errors import PlateFileError
from cpam_bayes.plate.instruments import UniversalFileError, decode, read_delimited, read_sets
from cpam_bayes.plate.modal_analysis.hits import (
    ClippedError,
    FrequencyResponses,
    ModalTestError,
    Recording,
    Window,
    require_unclipped,
    responses_of_hits,
    told_channels,
    without_silent,
)
from cpam_bayes.plate.modes_table import COLUMNS
from cpam_bayes.plate.text import read_regular_file

Array = NDArray[Any]
# A file of this size takes some seconds and less than 1 GiB.
_MOST_BYTES: Final = 50_000_000
_MOST_LINES, _MOST_COLUMNS = 200_000, 2_000
_MOST_SAMPLES: Final = 25_000_000
_UNIVERSAL, _TABLES, _WAVES = (".unv", ".uff", ".unf"), (".csv", ".txt", ".tsv", ".dat"), (".wav",)
_ACCEPTED: Final = (
    "frequency responses (a universal file with datasets 58, .unv or .uff; a table, .csv or .txt) or "
    "recorded hits (.wav)"
)
# Type of a frequency response function in a dataset 58.
_FRF: Final = 4
_HEADS: Final = {
    "f": ("khz", "hertz", *COLUMNS["hz"]),
    "re": ("re", "real", "realteil", "partie réelle", "parte real", "parte reale"),
    "im": (
        *("im", "imag", "imaginary", "imaginärteil", "imaginaerteil", "partie imaginaire"),
        *("parte imaginaria", "parte imaginária", "parte immaginaria"),
    ),
    "mag": ("mag", "magnitude", "abs", "amplitude", "betrag", "module", "módulo", "modulo", "ampiezza"),
    "phase": ("phase", "phasenwinkel", "fase"),
}
_KIND_OF: Final = {head: kind for kind, heads in _HEADS.items() for head in heads}
_HEAD = re.compile(rf"({'|'.join(map(re.escape, sorted(_KIND_OF, key=len, reverse=True)))})(?!\w)")
_DEGREES, _RADIANS = re.compile("deg|grad|[°º]"), re.compile("(?<!g)rad")
# Levels in dB differ by less than this factor, magnitudes of responses by more.
_LEVELS: Final = 20.0
_EVEN: Final = 1e-3
# Limits of the largest value of a response or record: beyond them sums of squares under- or overflow.
_LEAST_SIZE, _MOST_SIZE = 1e-60, 1e60
_LEAST_HZ, _MOST_HZ = 1e-3, 1e9


def read_responses(
    files: Sequence[str],
    *,
    force: int | None,
    response: Sequence[int],
    window: Window | None,
    high: float | None,
) -> FrequencyResponses:
    """The frequency responses of files of one format; a folder stands for all recordings in it.

    force, response : channels of a .wav file, from 1; without them a channel that is a pulse is the force
    window : applied to records, none unless given
    high : Hz, end of the range of recorded hits

    Raises ``ModalTestError`` for what cannot be read, with the file.
    """
    files, repeated = _each_once([path for name in files for path in of_folder(name)])
    endings = {Path(name).suffix.casefold() for name in files}
    if endings <= set(_WAVES):
        recordings, notices = _recordings(files, force, response)
        if len({one.rate for one in recordings}) > 1:
            raise ModalTestError("files of several sampling rates, accepted: one")
        if len({(one.force is None, len(one.responses)) for one in recordings}) > 1:
            raise ModalTestError("files of different channels, accepted: the same in all; say --response")
        recordings, silent = without_silent(recordings)
        found = responses_of_hits(recordings, window or "none", high)
        return replace(found, notices=(*repeated, *notices, *silent, *found.notices))
    if force is not None or response or window is not None:
        raise ModalTestError("--force, --response and --window: accepted: with .wav files only")
    of_files = [_universal(n) if Path(n).suffix.casefold() in _UNIVERSAL else _table(n) for n in files]
    first = of_files[0]
    if any(not np.array_equal(one.frequencies, first.frequencies) for one in of_files):
        raise ModalTestError("files with different lines of frequency, accepted: the same in all")
    origins = list(dict.fromkeys(one.origin for one in of_files))
    frf = np.vstack([one.frf for one in of_files])
    return FrequencyResponses(first.frequencies, frf, 0.0, "; ".join(origins), repeated)


def _each_once(files: Sequence[str]) -> tuple[list[str], tuple[Notice, ...]]:
    """Files with different contents, and a notice of the repeated ones that were left out."""
    of_content: dict[bytes, str] = {}
    repeated = []
    for name in files:
        digest = hashlib.sha256(_content(name)).digest()
        if digest in of_content:
            repeated.append(Path(name).name)
        of_content.setdefault(digest, name)
    return list(of_content.values()), (
        (Notice("repeated_files", facts={"files": tuple(repeated)}),) if repeated else ()
    )


def of_folder(name: str) -> list[str]:
    """The recordings of a folder in the order of their names, or the file itself."""
    if not Path(name).is_dir():
        return [name]
    found = sorted(str(path) for path in Path(name).iterdir() if path.suffix.casefold() in _WAVES)
    if not found:
        raise ModalTestError(f"{name}: no recordings in this folder, accepted: .wav files")
    return found


def _recordings(
    files: Sequence[str], force: int | None, response: Sequence[int]
) -> tuple[list[Recording], tuple[Notice, ...]]:
    """Recordings that are not clipped, and a notice of those that are; ``ClippedError`` where all are."""
    recordings, clipped = [], []
    for name in files:
        try:
            recordings.append(_recording(name, force, response))
        except ClippedError as error:
            clipped.append((Path(name).name, error))
    if not recordings:
        raise clipped[0][1]
    names = tuple(name for name, _ in clipped)
    return recordings, (Notice("clipped_files", facts={"files": names}),) if names else ()


def _content(name: str) -> bytes:
    if not os.path.exists(name):
        raise ModalTestError(f"{name}: no such file or folder, accepted: {_ACCEPTED}")
    if Path(name).suffix.casefold() not in (*_UNIVERSAL, *_TABLES, *_WAVES):
        raise ModalTestError(f"{name}: unknown ending, accepted: {_ACCEPTED}")
    try:
        return read_regular_file(name, name, _ACCEPTED, _MOST_BYTES)
    except (FileNotFoundError, PlateFileError) as error:
        raise ModalTestError(str(error)) from None


def _universal(name: str) -> FrequencyResponses:
    """The frequency responses of datasets 58, ASCII or binary."""
    try:
        sets = read_sets(_content(name), (58,))
    except UniversalFileError as error:
        raise ModalTestError(f"{name}: {error}") from None
    frf = [one for one in sets if one.get("func_type") == _FRF and np.iscomplexobj(one["data"])]
    if not frf:
        raise ModalTestError(f"{name}: no frequency response functions, accepted: datasets 58 of type 4")
    x = np.asarray(frf[0]["x"], dtype=float)
    if any(not np.array_equal(one["x"], x) for one in frf):
        raise ModalTestError(f"{name}: datasets 58 with different lines, accepted: the same in all")
    if any(len(one["data"]) != len(x) for one in frf):
        raise ModalTestError(f"{name}: a dataset 58 that ends within a line, accepted: whole files")
    return _checked(name, x, np.stack([one["data"] for one in frf]), f"dataset 58, {len(frf)} responses")


def _table(name: str) -> FrequencyResponses:
    """The responses of a table with a pair of columns for each: re and im, or magnitude and phase."""
    text = decode(_content(name))
    n_lines = text.count("\n") + text.count("\r")
    if n_lines > 2 * _MOST_LINES:  # two characters may end a line
        raise ModalTestError(f"{name}: received {n_lines} lines, accepted: {_MOST_LINES} at most")

    def is_header(heads: Sequence[str]) -> bool:
        return len(heads) <= _MOST_COLUMNS and len(_columns(heads)) > 2

    found = read_delimited(text, is_header)
    columns = [] if found is None else _columns(found.heads)
    kinds = [kind for kind, _, _ in columns]
    if found is None or kinds[0] != "f" or len(kinds) % 2 == 0 or set(kinds[1::2]) - {"re", "mag"}:
        raise ModalTestError(
            f"{name}: no table of responses, accepted: a line of heads with hz and then re and im, or "
            "magnitude and phase [deg], of each response"
        )
    rows = []
    for row in found.rows:
        try:
            cells = [row.cells[i] for _, _, i in columns]
            rows.append([float(c if found.separator == "," else c.replace(",", ".")) for c in cells])
        except (ValueError, IndexError):
            raise ModalTestError(f"{name}:{row.line}: not a row of {len(columns)} numbers") from None
    if not rows:
        raise ModalTestError(f"{name}: no rows below the heads, accepted: a row for each line of frequency")
    values = np.array(rows).T
    frf = []
    for k in range(1, len(columns), 2):
        (kind, unit, _), (_, angle, _) = columns[k], columns[k + 1]
        first, second = values[k], values[k + 1]
        if kind == "mag":
            _require_units(name, unit, angle, first, second)
            with np.errstate(over="ignore", invalid="ignore"):  # refused below
                size = 10.0 ** (first / 20.0) if "db" in unit else first
                turn = second if _RADIANS.search(angle) else np.radians(second)
                first, second = size * np.cos(turn), size * np.sin(turn)
        response = first.astype(complex)
        response.imag = second
        frf.append(response)
    scale = 1e3 if "khz" in columns[0][1] else 1.0
    return _checked(name, scale * values[0], np.array(frf), f"table, {len(frf)} responses")


def _require_units(name: str, unit: str, angle: str, magnitude: Array, phase: Array) -> None:
    """Raise ``ModalTestError`` where magnitude or phase cannot be in the unit that their headings state."""
    if "db" not in unit and np.any(magnitude < 0.0):
        raise ModalTestError(
            f"{name}: magnitudes below 0, down to {np.nanmin(magnitude):g}, accepted: 0 or above; of values "
            "in dB the head says [dB]"
        )
    most = np.nanmax(np.abs(phase), initial=0.0)
    if not _DEGREES.search(angle) and not _RADIANS.search(angle) and most <= 2.0 * np.pi:
        raise ModalTestError(
            f"{name}: phases up to {most:.3g} of no unit, accepted: phase [rad], or phase [deg]"
        )
    least, largest = np.nanmin(magnitude, initial=np.inf), np.nanmax(magnitude, initial=0.0)
    if not set(unit) & set("[(/") and "db" not in unit and largest < _LEVELS * least:
        raise ModalTestError(
            f"{name}: magnitudes from {least:g} to {largest:g} of no unit, as levels in dB are, accepted: "
            "magnitude [dB], or a unit such as magnitude [m/s2/N]"
        )


def _columns(heads: Sequence[str]) -> list[tuple[str, str, int]]:
    """Kind, whole heading and index of the columns that are read."""
    found = []
    for i, head in enumerate(heads):
        match = _HEAD.match(re.sub(r"[_\d]", " ", head.casefold()).strip())
        if match:
            found.append((_KIND_OF[match[1]], head.casefold(), i))
    return found


def _checked(name: str, frequencies: Array, frf: Array, origin: str) -> FrequencyResponses:
    highest = np.max(np.abs(frequencies), initial=0.0)
    if not _LEAST_HZ <= highest <= _MOST_HZ:
        raise ModalTestError(
            f"{name}: lines of frequency up to {highest:g} Hz, accepted: {_LEAST_HZ:g} to {_MOST_HZ:g} Hz"
        )
    steps = np.diff(frequencies)
    even = len(steps) > 0 and np.all(steps > 0.0) and np.ptp(steps) <= _EVEN * steps.mean() * len(steps)
    if not even or frequencies[0] < 0.0:
        raise ModalTestError(f"{name}: lines that do not ascend by equal steps, accepted: equal steps in Hz")
    missing = np.flatnonzero(~np.all(np.isfinite(frf), axis=0))
    if missing.any():  # analysers write no number at 0 Hz
        raise ModalTestError(
            f"{name}: no number at {frequencies[missing[-1]]:g} Hz, accepted: one at each line"
        )
    frf = np.where(np.isfinite(frf), frf, 0.0)
    for number, size in enumerate(np.max(np.abs(frf), axis=1), 1):
        if not _LEAST_SIZE < size < _MOST_SIZE:
            what = f"whose largest value is {size:.3g}" if size else "that is zero at all lines"
            raise ModalTestError(
                f"{name}: response {number} {what}, accepted: {_LEAST_SIZE:g} to {_MOST_SIZE:g}"
            )
    return FrequencyResponses(frequencies, frf, 0.0, origin)


def _recording(name: str, force: int | None, response: Sequence[int]) -> Recording:
    content = _content(name)
    try:
        # scipy warns of what it passes over, and of a length that a recorder never filled in
        with warnings.catch_warnings(action="ignore"):
            rate, samples = wavfile.read(io.BytesIO(content))
    except Exception as error:  # noqa: BLE001 - scipy raises what comes, of a head with zeros for instance
        raise ModalTestError(f"{name}: not a .wav file that can be read: {error}") from None
    channels = np.atleast_2d(samples.T)
    if not channels.size or not rate > 0:
        raise ModalTestError(f"{name}: {channels.size} samples, {rate} a second, accepted: above 0")
    if not response:
        force, response = told_channels(channels, float(rate), force)
    wanted = (*(() if force is None else (force,)), *response)
    for channel in wanted:
        if not 1 <= channel <= len(channels):
            raise ModalTestError(f"{name}: no channel {channel}, accepted: 1 to {len(channels)}")
    if len(wanted) * channels.shape[1] > _MOST_SAMPLES:
        raise ModalTestError(
            f"{name}: received {len(wanted)} channels of {channels.shape[1]} samples, accepted: "
            f"{_MOST_SAMPLES} samples at most; several files are one test"
        )
    if force is not None and force in response:
        raise ModalTestError(
            f"--force and --response: received {force} for both, accepted: different channels"
        )
    with np.errstate(invalid="ignore"):  # of floats that are no numbers
        signals = channels[[channel - 1 for channel in wanted]].astype(float)
    if not np.all(np.abs(signals) < _MOST_SIZE):
        raise ModalTestError(f"{name}: samples that are no numbers, accepted: numbers up to {_MOST_SIZE:g}")
    for channel in wanted:
        require_unclipped(name, channel, channels[channel - 1])
    if force is None:
        return Recording(float(rate), None, signals, wanted, Path(name).name)
    return Recording(float(rate), signals[0], signals[1:], wanted, Path(name).name)
