"""Recordings of hits with the defects of real ones: hum, second strokes, clipping, drift, background noise.

Damping (0.3 to 1.4 %), decay within half a second, amplitudes that differ by a factor of 30, louder modes
far above the range and a scatter of 0.02 to 0.2 % from hit to hit are typical of wooden and metal plates.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

RATE = 8000
ABOVE = (1650.0, 2300.0, 3100.0)
# Damping ratio of modes above the range.
DAMPING_ABOVE = 8e-3


@dataclass(frozen=True, slots=True)
class Faults:
    """Defects of a test.

    hum : amplitude at 50 Hz and its triple, relative to the largest value of a record
    second_stroke : s after the first, None for one stroke
    twice : fraction of the hits with a second stroke, the first ones
    drift : standard deviation of each frequency from hit to hit, as a fraction
    noise : standard deviation relative to the largest value of a record
    clipped : number of clipped hits, the last ones
    """

    hum: float = 0.0
    second_stroke: float | None = None
    twice: float = 1.0
    drift: float = 0.0003
    noise: float = 0.001
    clipped: int = 0


def eigenvalues(frequencies: Array, damping: Array) -> NDArray[np.complex128]:
    """s = omega (-zeta + i sqrt(1 - zeta^2)), rad/s."""
    omega = 2.0 * np.pi * frequencies
    return np.asarray(-damping * omega + 1j * omega * np.sqrt(1.0 - damping**2))


def recorded_hits(
    rng: np.random.Generator,
    frequencies: Array,
    damping: Array,
    n_hits: int,
    faults: Faults = Faults(),
    seconds: float = 1.5,
    above: Sequence[float] = ABOVE,
) -> list[NDArray[np.int16]]:
    """Accelerations of the hits, (n_samples,) each, without the force.

    above : Hz, loud modes beyond the range of interest
    """
    t = np.arange(int(RATE * seconds)) / RATE
    heights = np.append(10.0 ** rng.uniform(-1.5, 0.0, len(frequencies)), np.ones(len(above)))
    frequencies, damping = (
        np.append(frequencies, above),
        np.append(damping, np.full(len(above), DAMPING_ABOVE)),
    )
    records = []
    for k in range(n_hits):
        s = eigenvalues(frequencies * (1.0 + faults.drift * rng.standard_normal(len(frequencies))), damping)
        decay = heights @ np.exp(s[:, None] * t).imag
        force = np.zeros_like(t)
        force[80:84] = (0.5, 1.0, 1.0, 0.5)
        if faults.second_stroke is not None and k < faults.twice * n_hits:
            at = 80 + int(faults.second_stroke * RATE)
            force[at : at + 4] = (0.4, 0.8, 0.8, 0.4)
        signal = np.convolve(force, decay)[: len(t)]
        signal /= np.abs(signal).max()
        for multiple in (1, 3):
            signal += faults.hum * np.sin(2.0 * np.pi * 50.0 * multiple * t + rng.uniform(0.0, 6.0))
        signal += faults.noise * rng.standard_normal(len(t))
        record: Any = (20000.0 * signal / np.abs(signal).max()).astype(np.int16)
        if k >= n_hits - faults.clipped:
            record = np.clip(3 * record.astype(int), -32768, 32767).astype(np.int16)
        records.append(record)
    return records
