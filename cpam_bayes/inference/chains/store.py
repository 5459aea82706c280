"""Finished rounds of chains on disk, a file each.

A round is a sealed file: what is there under its own name is whole, at whatever moment a run was killed. One
that was damaged since is set aside and sampled again, the same bit for bit.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.storage import read_arrays, write_arrays
from cpam_bayes.storage.arrays import ARRAYS

Array = NDArray[Any]


class StoreError(ValueError):
    """A store that cannot be used: of another problem or version, damaged, or not to be written."""


class Rounds:
    """Finished rounds of one problem in a directory; a round of another problem is refused.

    Raises ``StoreError`` where the directory cannot be made, or holds rounds of an earlier version.
    """

    def __init__(self, directory: Path, key: str) -> None:
        self.directory, self.key = directory, key
        try:
            directory.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise StoreError(f"store {directory}: cannot be made: {error.strerror}") from error
        self._refuse_earlier_rounds()

    def path(self, i: int) -> Path:
        """Where a round is or will be."""
        return self.directory / f"round_{i:04d}{ARRAYS}"

    def read(self, i: int) -> tuple[Array, Array, list[Any]] | None:
        """A stored round, or ``None`` if it was not finished, or is damaged: it is set aside.

        Raises ``StoreError`` for a round of another problem, and one that cannot be read.
        """
        import emcee

        path = self.path(i)
        try:
            stored = read_arrays(path)
        except OSError as error:
            raise StoreError(f"store {path}: cannot be read: {error.strerror}") from error
        if stored is None:
            return None
        if str(stored.get("problem")) != self.key:
            raise StoreError(
                f"store {path}: holds another problem (plate, priors, data, settings, seed "
                "or version differ); choose another directory or remove it"
            )
        chain, log_prob = stored["chain"], stored["log_prob"]
        states = [
            emcee.State(
                chain[e, -1],
                log_prob=log_prob[e, -1],
                random_state=(
                    "MT19937",
                    stored["random_keys"][e],
                    int(stored["random_position"][e]),
                    int(stored["random_has_gauss"][e]),
                    float(stored["random_gauss"][e]),
                ),
            )
            for e in range(len(chain))
        ]
        return chain, log_prob, states

    def write(self, i: int, chain: Array, log_prob: Array, states: list[Any]) -> str | None:
        """Store a round; what to say if it could not be."""
        random = [s.random_state for s in states]
        arrays = {
            "problem": np.array(self.key),
            "chain": chain,
            "log_prob": log_prob,
            "random_keys": np.stack([r[1] for r in random]),
        }
        for k, name in ((2, "position"), (3, "has_gauss"), (4, "gauss")):
            arrays[f"random_{name}"] = np.array([r[k] for r in random])
        path = self.path(i)
        try:
            write_arrays(path, arrays)
        except OSError as error:
            return (
                f"store {path}: cannot be written ({error.strerror or error}); {i} rounds before it are kept "
                "and the same command goes on from there, those from it on are in this answer alone"
            )
        return None

    def _refuse_earlier_rounds(self) -> None:
        earlier = sorted(self.directory.glob("round_*.h5"))
        if earlier:
            raise StoreError(
                f"store {self.directory}: holds rounds of an earlier version ({earlier[0].name} and on), "
                "which this one cannot go on from and leaves alone; choose another directory"
            )
