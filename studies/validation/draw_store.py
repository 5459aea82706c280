"""Results of many independent repetitions on disk, one line each, saved as they finish."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from cpam_bayes.calibration import (
    N_DRAWS,
    Experiment,
    Repetition,
    calibrate,
    nature_of,
    prior_draw,
    prior_of,
)
from cpam_bayes.fingerprint import fingerprint
from cpam_bayes.inference.ensemble import StoreError
from cpam_bayes.storage import seal_of

_SEAL_DIGITS: Final = 16


@dataclass(frozen=True, slots=True)
class DrawStore:
    """A file of lines with a checksum and a JSON document each: the hash of the problem, then the records.

    A line counts once its end is written, so a run killed at any moment loses at most the record that it was
    writing. A store begun before lines had checksums continues without them.

    records : those present when the store was opened.
    sealed : whether its lines have checksums.
    """

    path: Path
    records: tuple[dict[str, Any], ...]
    sealed: bool = True

    @classmethod
    def open(cls, path: Path, key: str) -> DrawStore:
        """Open the store of the problem with this hash, or begin it if the file is missing or empty.

        Raises ``StoreError`` for a file of another problem, one damaged before its last line, or one that
        cannot be read or written.
        """
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            content = path.read_bytes() if path.exists() else b""
            if not content:
                _append(path, {"problem": key}, sealed=True)
                return cls(path, ())
        except OSError as error:
            raise StoreError(f"store {path}: cannot be used: {error.strerror}") from error
        whole = content[: content.rfind(b"\n") + 1]
        sealed = not whole.startswith(b"{")
        try:
            head, *records = [_record(line, sealed) for line in whole.splitlines()]
            problem_stored = head["problem"]
        except (ValueError, KeyError, TypeError) as error:
            raise StoreError(
                f"store {path}: is damaged or no store of this package; remove it to begin anew"
            ) from error
        if problem_stored != key:
            raise StoreError(
                f"store {path}: holds another problem (code, plate, priors, noise, settings or seed differ); "
                "choose another file or remove it"
            )
        if len(whole) < len(content):
            os.truncate(path, len(whole))
        return cls(path, tuple(records), sealed)

    def append(self, record: dict[str, Any]) -> None:
        """Append a record; floats are read back bit for bit. Raises ``StoreError`` if writing fails."""
        try:
            _append(self.path, record, self.sealed)
        except OSError as error:
            raise StoreError(
                f"store {self.path}: cannot be written ({error.strerror}); what it holds is kept"
            ) from error


def _record(line: bytes, sealed: bool) -> Any:
    """Content of a line; raises ``ValueError`` if it is damaged."""
    if not sealed:
        return json.loads(line)
    seal, _, text = line.partition(b" ")
    if seal.decode("ascii") != _line_seal(text):
        raise ValueError("the checksum of a line is wrong")
    return json.loads(text)


def _line_seal(text: bytes) -> str:
    return seal_of("", text)[:_SEAL_DIGITS]


def _append(path: Path, record: dict[str, Any], sealed: bool) -> None:
    text = json.dumps(record).encode()
    line = f"{_line_seal(text)} ".encode() + text if sealed else text
    with path.open("ab") as file:
        file.write(line + b"\n")
        file.flush()
        os.fsync(file.fileno())


def stored_calibration(
    experiment: Experiment,
    repetitions: int,
    store: Path,
    *,
    executor: Executor | None = None,
    progress: Callable[[int], None] = lambda done: None,
) -> tuple[Repetition, ...]:
    """Repetitions of an experiment, each stored when it ends; ``progress`` is called with the number done.

    Raises ``StoreError`` for a store of another experiment.
    """
    kept = DrawStore.open(store, experiment_hash(experiment))
    known = [_repetition(record) for record in kept.records]
    done = len(known)

    def keep(repetition: Repetition) -> None:
        nonlocal done
        kept.append(asdict(repetition))
        done += 1
        progress(done)

    return calibrate(experiment, repetitions, known=known, executor=executor, on_result=keep)


def experiment_hash(experiment: Experiment) -> str:
    """Hash of everything that a repetition depends on: code, priors, predictions, noise, settings, seed."""
    nature = nature_of(experiment.source)
    posterior = prior_of(experiment, nature)
    rng = np.random.default_rng(0)
    x = np.stack([prior_draw(posterior, rng) for _ in range(3)])
    predicted = nature.model.predict(x[:, : nature.model.parameters.size]).frequencies
    parts = [
        fingerprint("cpam_bayes.calibration"),
        posterior.parameters.names,
        [repr(p.prior) for p in posterior.parameters.parameters],
        [[f"{f:.7g}" for f in row] for row in predicted],
        [f"{e:.3g}" for e in nature.solver_error],
        experiment.resolution,
        experiment.relative_std,
        experiment.seed,
        asdict(experiment.settings),
        asdict(experiment.swarm),
        N_DRAWS,
    ]
    return hashlib.sha256(json.dumps(parts).encode()).hexdigest()[:32]


def _repetition(record: dict[str, Any]) -> Repetition:
    fields: dict[str, Any] = {k: tuple(v) if isinstance(v, list) else v for k, v in record.items()}
    return Repetition(**fields)
