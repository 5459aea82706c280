"""Posterior files with draws that are known."""

from pathlib import Path
from typing import Any

import arviz_base
import numpy as np


def write_posterior(path: Path, draws: dict[str, Any], **attributes: Any) -> Path:
    """A ``posterior.nc`` of one chain; draws by their names in plate files, in their units."""
    data = arviz_base.from_dict(
        {"posterior": {k: np.asarray(v)[None] for k, v in draws.items()}}, attrs={"/": attributes}
    )
    data.to_netcdf(str(path))
    return path
