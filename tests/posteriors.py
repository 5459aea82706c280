"""Posterior files with known draws."""

from pathlib import Path
from typing import Any

import arviz_base
import numpy as np


def write_posterior(path: Path, draws: dict[str, Any], **attributes: Any) -> Path:
    """A ``posterior.nc`` of one chain; draws by their names and in their units in plate files."""
    of_one_chain = {"posterior": {name: np.asarray(values)[None] for name, values in draws.items()}}
    arviz_base.from_dict(of_one_chain, attrs={"/": attributes}).to_netcdf(str(path))
    return path
