"""Finished rounds of chains on disk, a file each.

A round is written under another name and renamed: what is there under its own name is whole, at whatever
moment a run was killed.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]


class StoreError(ValueError):
    """A store that cannot be used: of another problem, damaged, or not to be written."""


class Rounds:
    """Finished rounds of one problem in a directory; a round of another problem is refused.

    Raises ``StoreError`` where the directory cannot be made.
    """

    def __init__(self, directory: Path, key: str) -> None:
        self.directory, self.key = directory, key
        try:
            directory.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise StoreError(f"store {directory}: cannot be made: {error.strerror}") from error

    def path(self, i: int) -> Path:
        """Where a round is or will be."""
        return self.directory / f"round_{i:04d}.h5"

    def read(self, i: int) -> tuple[Array, Array, list[Any]] | None:
        """A stored round, or ``None`` if it was not finished."""
        import emcee
        import h5py

        path = self.path(i)
        if not path.exists():
            return None
        try:
            with h5py.File(path, "r") as file:
                if file.attrs.get("problem") != self.key:
                    raise StoreError(
                        f"store {path}: holds another problem (plate, priors, data, settings, seed "
                        "or version differ); choose another directory or remove it"
                    )
                chain, log_prob = file["chain"][:], file["log_prob"][:]
                states = [
                    emcee.State(
                        chain[e, -1],
                        log_prob=log_prob[e, -1],
                        random_state=(
                            "MT19937",
                            file["random_keys"][e],
                            int(file["random_position"][e]),
                            int(file["random_has_gauss"][e]),
                            float(file["random_gauss"][e]),
                        ),
                    )
                    for e in range(len(chain))
                ]
        except (OSError, KeyError) as error:
            raise StoreError(
                f"store {path}: is damaged or no HDF5 file of this package; remove it to sample that "
                "round again"
            ) from error
        return chain, log_prob, states

    def write(self, i: int, chain: Array, log_prob: Array, states: list[Any]) -> str | None:
        """Store a round; what to say if it could not be."""
        import h5py

        path = self.path(i)
        part = path.with_suffix(".part")
        try:
            with h5py.File(part, "w") as file:
                file.attrs["problem"] = self.key
                file["chain"], file["log_prob"] = chain, log_prob
                random = [s.random_state for s in states]
                file["random_keys"] = np.stack([r[1] for r in random])
                for k, name in ((2, "position"), (3, "has_gauss"), (4, "gauss")):
                    file[f"random_{name}"] = np.array([r[k] for r in random])
            part.replace(path)
        except (OSError, RuntimeError) as error:  # h5py: either, as the write or the closing fails
            part.unlink(missing_ok=True)
            said = re.search(r"error message = '([^']*)'", str(error))  # deep in a text of HDF5's
            reason = said[1] if said else getattr(error, "strerror", None) or str(error).splitlines()[0]
            return (
                f"store {path}: cannot be written ({reason}); {i} rounds before it are kept and the same "
                "command goes on from there, those from it on are in this answer alone"
            )
        return None
