"""Universal files written line by line after their documentation, without a library."""

from collections.abc import Sequence

import numpy as np


def block(kind: int, *lines: str) -> str:
    return "\n".join(["    -1", f"{kind:6d}", *lines, "    -1", ""])


def nodes_15(points: np.ndarray, numbers: Sequence[int] | None = None) -> str:
    """Nodes (n, 2 or 3), one line each: 4I10, 1P3E13.5."""
    rows = np.column_stack((points, np.zeros((len(points), 3 - points.shape[1]))))
    lines = [
        f"{number:10d}{0:10d}{0:10d}{8:10d}" + "".join(f"{value:13.5E}" for value in row)
        for number, row in zip(numbers or range(1, len(rows) + 1), rows, strict=True)
    ]
    return block(15, *lines)


def nodes_2411(points: np.ndarray) -> str:
    """Nodes (n, 2), two lines each: 4I10, 1P3D25.16 with the exponents of double precision."""
    lines = []
    for number, (x, y) in enumerate(points, 1):
        lines.append(f"{number:10d}{1:10d}{1:10d}{11:10d}")
        lines.append("".join(f"{value:25.16E}".replace("E", "D") for value in (x, y, 0.0)))
    return block(2411, *lines)


def units_164(length: float) -> str:
    """Units defined by the factor of length, which multiplies SI values."""
    factors = "".join(f"{value:25.16E}".replace("E", "D") for value in (length, 1.0, 1.0))
    offset = f"{273.15:25.16E}".replace("E", "D")
    return block(164, f"{1:10d}{'SI':>20s}{2:10d}", factors, offset)


def mode_55(frequency, shape, number=1, *, viscous=0.0, hysteretic=0.0, damping=None, nodes=None):
    """A mode with its shape (3, n): normal, or complex with its eigenvalue if ``damping`` is given."""
    heads = [f"shape {number}", *["NONE"] * 4]
    if damping is None:
        kind = [f"{1:10d}{2:10d}{2:10d}{8:10d}{2:10d}{3:10d}", f"{2:10d}{4:10d}{1:10d}{number:10d}"]
        values = (frequency, 1.0, viscous, hysteretic)
    else:
        kind = [f"{1:10d}{3:10d}{2:10d}{8:10d}{5:10d}{3:10d}", f"{2:10d}{6:10d}{1:10d}{number:10d}"]
        omega = 2.0 * np.pi * frequency
        values = (-damping * omega, omega * np.sqrt(1.0 - damping**2), 1.0, 0.0, 0.0, 0.0)
    lines = []
    for node, column in zip(nodes or range(1, shape.shape[1] + 1), shape.T, strict=True):
        lines.append(f"{node:10d}")
        parts = np.column_stack((column.real, column.imag)).ravel() if damping is not None else column
        lines.append("".join(f"{value:13.5E}" for value in parts))
    return block(55, *heads, *kind, "".join(f"{value:13.5E}" for value in values), *lines)


def grid(length: float, width: float, n_x: int = 5, n_y: int = 4) -> np.ndarray:
    x, y = np.linspace(0.0, length, n_x), np.linspace(0.0, width, n_y)
    return np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)
