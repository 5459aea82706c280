"""Draws of a posterior as arviz InferenceData: units, versions, and the same file for the same seed."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final

import numpy as np

from cpam_bayes import __version__
from cpam_bayes.inference.chains.ensemble import problem_hash
from cpam_bayes.plate import Specimen, to_user, unit_of, user_name

__all__ = ["arviz_data", "by_user_name", "command_of_draws"]

# Name of the attribute.
_COMMAND: Final = "command"
# arviz writes its own version, into every group.
_LIBRARIES: Final = ("numpy", "scipy", "emcee")


def command_of_draws(file: Path) -> str | None:
    """The command whose draws a file holds, None for a file of something else."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FutureWarning)
        import arviz
    read: Callable[[str], Any] = arviz.from_netcdf
    try:
        data = read(str(file))
    except (OSError, ValueError):  # not NetCDF
        return None
    found = data.attrs.get(_COMMAND)
    data.close()
    return None if found is None else str(found)


def by_user_name(names: tuple[str, ...], draws: np.typing.NDArray[Any]) -> dict[str, Any]:
    """Draws (chains, draws, n) by their names in the plate file, in its units."""
    return {user_name(name): draws[..., i] * to_user(name, 1.0) for i, name in enumerate(names)}


def arviz_data(
    command: str,
    specimen: Specimen,
    seed: int,
    sampled: Any,
    attributes: Mapping[str, Any],
    log_prior: Mapping[str, Any] | None = None,
    **groups: Any,
) -> Any:
    """The groups as ``arviz.InferenceData``.

    command : whose answer they are of, see `command_of_draws`.
    sampled : the posterior that the hash of the problem is of.
    attributes : beside command, versions, plate, seed and hash.
    log_prior : by parameter.
    groups : as of ``arviz.from_dict``.
    """
    with warnings.catch_warnings():
        # arviz announces its next version, and takes many walkers with few thinned draws for a slip
        warnings.simplefilter("ignore", FutureWarning)
        warnings.simplefilter("ignore", UserWarning)
        import arviz

        centre = np.array([[p.prior.mean for p in sampled.parameters.parameters]])
        attrs = {
            _COMMAND: command,
            "cpam_bayes_version": __version__,
            **{f"{library}_version": version(library) for library in _LIBRARIES},
            "plate": specimen.name,
            "source": specimen.source,
            "seed": seed,
            "problem_hash": problem_hash(sampled, centre),
            **attributes,
        }
        data = arviz.from_dict(**groups, attrs=attrs)
        if log_prior is not None:  # from_dict drops this group without a word
            data.add_groups({"log_prior": dict(log_prior)})
    for group in (data[name] for name in ("posterior", "prior") if name in data.groups()):
        for name in sampled.parameters.names:
            group[user_name(name)].attrs["unit"] = unit_of(name)
    for name in data.groups():
        data[name].attrs.pop("created_at", None)
    return data
