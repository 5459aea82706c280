"""Recordings of hits with the faults of real ones: hum, second strokes, clipping, drift, background noise.

Damping (0.3 to 1.4 %), decay within half a second, modes that differ in height by a factor of 30, louder ones
far above the range and scatter of 0.02 to 0.2 % from hit to hit are those of wooden and metal plates.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tests.synthetic_poles import eigenvalues

RATE = 8000
ABOVE = (1650.0, 2300.0, 3100.0)


@dataclass(frozen=True)
class Faults:
    """What is wrong with a test.

    hum : amplitude of 50 Hz and its triple over the largest value of a record
    second_stroke : s after the first, None for one stroke
    drift : standard deviation of each frequency from hit to hit, as a fraction
    noise : standard deviation over the largest value of a record
    """

    hum: float = 0.0
    second_stroke: float | None = None
    drift: float = 0.0003
    noise: float = 0.001


def recorded_hits(
    rng: np.random.Generator,
    frequencies: np.ndarray,
    damping: np.ndarray,
    n_hits: int,
    faults: Faults = Faults(),
    seconds: float = 1.5,
) -> list[np.ndarray]:
    """Accelerations of hits (n_samples,) each, int16, without the force."""
    t = np.arange(int(RATE * seconds)) / RATE
    heights = np.append(10.0 ** rng.uniform(-1.5, 0.0, len(frequencies)), np.ones(len(ABOVE)))
    frequencies, damping = np.append(frequencies, ABOVE), np.append(damping, np.full(len(ABOVE), 8e-3))
    records = []
    for _ in range(n_hits):
        s = eigenvalues(frequencies * (1.0 + faults.drift * rng.standard_normal(len(frequencies))), damping)
        decay = heights @ np.exp(s[:, None] * t).imag
        force = np.zeros_like(t)
        force[80:84] = (0.5, 1.0, 1.0, 0.5)
        if faults.second_stroke is not None:
            at = 80 + int(faults.second_stroke * RATE)
            force[at : at + 4] = (0.4, 0.8, 0.8, 0.4)
        signal = np.convolve(force, decay)[: len(t)]
        signal /= np.abs(signal).max()
        for k in (1, 3):
            signal += faults.hum * np.sin(2.0 * np.pi * 50.0 * k * t + rng.uniform(0.0, 6.0))
        signal += faults.noise * rng.standard_normal(len(t))
        records.append((20000.0 * signal / np.abs(signal).max()).astype(np.int16))
    return records
