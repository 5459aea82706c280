"""Frequency responses of a modal test, and what can be wrong with them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["FrequencyResponses", "ModalTestError"]

Array = NDArray[Any]


class ModalTestError(ValueError):
    """A test that cannot be read or analysed."""


@dataclass(frozen=True, slots=True, eq=False)
class FrequencyResponses:
    """Frequency responses at equal steps of frequency.

    frequencies : (n,) Hz
    frf : (n_responses, n) complex, response over force, or the spectrum of a free decay
    added_decay : rad/s that a window adds to the decay of every mode
    correlation : of the noise of a line with that of the next one, by the window
    origin : the format and what was read, in words
    remarks : what makes them doubtful, a sentence each
    """

    frequencies: Array
    frf: Array
    added_decay: float
    correlation: float
    origin: str
    remarks: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for name in ("frequencies", "frf"):
            array = np.array(getattr(self, name))
            array.flags.writeable = False
            object.__setattr__(self, name, array)

    @property
    def step(self) -> float:
        """Between two lines, Hz."""
        return float(self.frequencies[1] - self.frequencies[0])
