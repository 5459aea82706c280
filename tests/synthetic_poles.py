"""Frequency responses of known poles, some of them close together, with noise."""

from dataclasses import dataclass

import numpy as np

from cpam_bayes.plate.modal_analysis.hits import FrequencyResponses
from validation.recorded_hits import eigenvalues


@dataclass(frozen=True)
class Known:
    """A test with the truth: frequencies, Hz, damping ratios, and each mode's peak relative to the noise."""

    responses: FrequencyResponses
    frequencies: np.ndarray
    damping: np.ndarray
    peak_over_noise: np.ndarray


def accelerance(lines: np.ndarray, s: np.ndarray, residues: np.ndarray) -> np.ndarray:
    """-w^2 sum_r [A / (i w - s) + conj(A) / (i w - conj(s))], (n_responses, n) -> (n_responses, n_lines)."""
    w = 2j * np.pi * lines
    modes = residues[:, :, None] / (w - s[:, None])
    modes = modes + residues.conj()[:, :, None] / (w - s.conj()[:, None])
    return np.asarray(w**2 * modes.sum(axis=1))


def known_test(rng: np.random.Generator, n_responses: int = 3, noise: float = 0.01) -> Known:
    """Three to seven modes from 60 to 740 Hz, plus one within 0.8 to 2 peak widths of one of them.
    noise : standard deviation relative to the largest value of each response"""
    f = np.sort(rng.uniform(60.0, 740.0, 7))
    f = f[np.append(True, np.diff(f) > 25.0)]
    damping = rng.uniform(0.003, 0.012, len(f))
    k = int(rng.integers(len(f)))
    f = np.append(f, f[k] + rng.uniform(0.8, 2.0) * 2.0 * damping[k] * f[k])
    damping = np.append(damping, damping[k] * rng.uniform(0.8, 1.2))
    order = np.argsort(f)
    f, damping = f[order], damping[order]
    s, lines = eigenvalues(f, damping), np.arange(0.5, 800.0, 0.5)
    residues = rng.standard_normal((n_responses, len(f))) / (2j * s.imag)  # like modes of equal mass
    frf = accelerance(lines, s, residues)
    sd = noise * np.abs(frf).max(axis=1, keepdims=True)
    peak = np.max(np.abs(residues * s**2 / s.real) / sd, axis=0)
    noisy = frf + sd * (rng.standard_normal(frf.shape) + 1j * rng.standard_normal(frf.shape)) / np.sqrt(2.0)
    return Known(FrequencyResponses(lines, noisy, 0.0, "synthetic"), f, damping, peak)
