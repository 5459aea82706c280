"""What an engineer must know about a point estimate, in sentences."""

from __future__ import annotations

import math

from cpam_bayes.formatting import significant
from cpam_bayes.identification.point import ConstantEstimate, PointEstimate
from cpam_bayes.identification.verdicts import MISFIT
from cpam_bayes.plate import to_user, unit_of, user_name

__all__ = ["noise_sentence", "verdict_sentences"]


def verdict_sentences(result: PointEstimate) -> tuple[str, ...]:
    """Which constants to believe, and why not the others."""
    if not math.isfinite(result.noise):
        n = result.predicted
        first = (
            f"No standard deviations: {len(n)} frequencies for {len(result.constants)} unknowns "
            "leave nothing to tell the noise by. Give relative_std or more frequencies.",
        )
        on_bound = [c for c in result.constants if c.bound is not None]
        return first + tuple(_verdict(result, c) for c in on_bound)
    sure = [c.name for c in result.constants if c.verdict == "determined by the data" and not c.elsewhere]
    doubtful = tuple(_verdict(result, c) for c in result.constants if c.name not in sure)
    determined = f"Determined by the frequencies: {', '.join(sure) or 'none of the constants'}."
    return (*doubtful, determined)


def _verdict(result: PointEstimate, constant: ConstantEstimate) -> str:
    name = constant.name
    if constant.bound is not None:
        value = constant.lower if constant.bound == "lower" else constant.upper
        shown = f"{to_user(name, value):g} {user_name(name).removeprefix(name).strip('_')}".strip()
        return (
            f"{name} sits on its {constant.bound} bound, {shown}: the bound decided, not the "
            "frequencies. Its sd does not hold there, and the other constants depend on the bound."
        )
    if constant.elsewhere:
        others = " or ".join(f"{to_user(name, v):.4g}" for v in constant.elsewhere)
        best = f"{to_user(name, constant.value):.4g}"
        return (
            f"{name} may be {best} or {others} {unit_of(name)}".rstrip()
            + ": the noise does not tell these optima apart. Labels of the modes, or more modes, may."
        )
    percent = 100 * constant.sd / result.specimen.unknowns[name].prior.sd
    spread = f"its sd is {percent:.0f} % of that of the search interval"
    if constant.verdict == MISFIT:
        return f"{name} is not determined: the plate model does not describe the frequencies."
    if constant.verdict == "determined by the prior":
        return f"{name} is not determined by the frequencies: {spread}. Do not use its value."
    return f"{name} is weakly determined by the frequencies: {spread}."


def noise_sentence(result: PointEstimate) -> str:
    """What the standard deviations stand on."""
    measurement = result.specimen.measurement
    assert measurement is not None
    if not math.isfinite(result.noise):
        return "not known"
    level = f"{significant(100 * result.noise, 2)} % of a frequency"
    rounding = f", and the rounding to {measurement.resolution:g} Hz" if measurement.resolution else ""
    if not result.noise_is_inferred:
        key = f"{measurement.sd_source}, on average" if measurement.frequency_sd is not None else ""
        return f"{level}, from the plate file ({key or 'relative_std'}){rounding}"
    freedom = measurement.size - len(result.constants)
    return (
        f"{level}, inferred from the residuals ({measurement.size} frequencies less "
        f"{len(result.constants)} unknowns: {freedom} left over){rounding}"
    )
