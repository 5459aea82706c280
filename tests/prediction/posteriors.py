"""Posterior files with draws that are known."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import numpy as np


def write_posterior(path: Path, draws: dict[str, Any], **attributes: Any) -> Path:
    """A ``posterior.nc`` of one chain; draws by their names in plate files, in their units."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FutureWarning)
        import arviz

        data = arviz.from_dict({k: np.asarray(v)[None] for k, v in draws.items()}, attrs=attributes)
    data.to_netcdf(str(path))
    return path
