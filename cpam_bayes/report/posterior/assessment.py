"""Tables of what determines a sampled posterior: the frequencies, the priors or their bounds."""

from __future__ import annotations

import math

import numpy as np

from cpam_bayes.formatting import NOT_KNOWN, fixed, significant
from cpam_bayes.identification.sampled import SampledResult
from cpam_bayes.identification.verdicts import BY_DATA, BY_PRIOR
from cpam_bayes.inference.diagnostics.identifiability import Combination
from cpam_bayes.inference.diagnostics.power_scaling import MOVED, MovedBound
from cpam_bayes.inference.diagnostics.profiles import Profile
from cpam_bayes.plate import to_user
from cpam_bayes.report.tables import Column, Table, headed

__all__ = ["combinations_table", "product_text", "sensitivity_table"]

# Smaller exponents are left out of a product.
_SMALL = 0.05
# Diagnoses that a reader must not overlook.
_DOUBTFUL = ("prior and data disagree", "prior is strong, likelihood weak", "likelihood is weak")
# Shift of a mean, in sd, from which moving a bound is worth telling.
_TOLD = 0.1


def combinations_table(result: SampledResult) -> Table:
    """Products of constants, the best determined first, with their spread by data and by prior."""
    columns = headed("combination", "#sd by data", "#sd by prior", "#prior / data", "decided by")
    names = result.posterior.model.parameters.names
    combinations = result.assessment.combinations
    rows = tuple(
        (
            product_text(names, c),
            _percent(c.noise_sd),
            _percent(c.prior_sd),
            significant(c.singular_value, 2),
            _decider(c),
        )
        for c in combinations
    )
    doubtful = frozenset(i for i, c in enumerate(combinations) if c.contraction < BY_PRIOR)
    return Table("Combinations of constants, best determined first", columns, rows, doubtful)


def product_text(names: tuple[str, ...], combination: Combination) -> str:
    """A product of powers, the largest first: ``E1 G12^0.32``; exponents below 0.05 are left out."""
    order = np.argsort(-np.abs(combination.exponents), kind="stable")
    parts = []
    for k in order:
        power = float(combination.exponents[k])
        if abs(power) >= _SMALL:
            parts.append(names[k] if round(power, 2) == 1.0 else f"{names[k]}^{power:.2g}")
    return " ".join(parts)


def _decider(combination: Combination) -> str:
    if combination.contraction >= BY_DATA:
        return "the data"
    return "the prior" if combination.contraction < BY_PRIOR else "data and prior"


def _percent(sd: float) -> str:
    """A standard deviation of a logarithm."""
    return f"{significant(100.0 * sd, 2)} %" if sd < 1.0 else "> 100 %"


def sensitivity_table(result: SampledResult) -> Table:
    """What the likelihood says of each constant alone, and what prior and bounds add."""
    assessment = result.assessment
    by_name = {s.name: s for s in assessment.power_scaling}
    columns = (
        Column("name"),
        Column("95 % by likelihood"),
        Column("likelihood", number=True),
        Column("prior", number=True),
        Column("noise prior", number=True),
        Column("diagnosis"),
        Column(f"a bound moved {100 * MOVED:.0f} %"),
    )
    names = result.posterior.parameters.names
    rows, doubtful = [], []
    for i, profile in enumerate(assessment.profiles):
        s = by_name[profile.name]
        sensitivities = (fixed(value, 2) for value in (s.likelihood, s.prior, s.noise_prior))
        shift = _largest_shift(assessment.moved_bounds, names.index(profile.name))
        rows.append((profile.name, _interval(profile), *sensitivities, s.diagnosis, shift))
        if s.diagnosis in _DOUBTFUL:
            doubtful.append(i)
    title = "Profile likelihood, and sensitivity to powers of likelihood and priors (0.05 counts)"
    return Table(title, columns, tuple(rows), frozenset(doubtful))


def _interval(profile: Profile) -> str:
    """The 95 % region of a profile, in the unit of the plate file."""
    gaps = "" if profile.parts == 1 else f" in {profile.parts} parts"
    if profile.lower_open and profile.upper_open:
        return f"anything{gaps}"
    width = profile.upper - profile.lower
    digits = max(0, 1 - math.floor(math.log10(to_user(profile.name, width)))) if width > 0.0 else 3
    lower, upper = (fixed(to_user(profile.name, v), digits) for v in (profile.lower, profile.upper))
    if profile.lower_open:
        return f"up to {upper}{gaps}"
    return f"from {lower}{gaps}" if profile.upper_open else f"{lower} to {upper}{gaps}"


def _largest_shift(moved: tuple[MovedBound, ...], k: int) -> str:
    """The largest shift of the mean of parameter k by a bound, ``-`` where it is small."""
    known = [m for m in moved if np.isfinite(m.shift[k])]
    if not known:
        return NOT_KNOWN
    largest = max(known, key=lambda m: abs(m.shift[k]))
    if abs(largest.shift[k]) < _TOLD:
        return NOT_KNOWN
    return f"{largest.shift[k]:+.1f} sd, {largest.bound} of {largest.name}"
