"""The parts of an answer: constants, frequencies, notices. Made once by the verbs, in SI, used by all.

Nothing here knows how an answer looks: `cpam_bayes.render` writes it.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from enum import Enum
from typing import Any, Literal, TypeAlias

from cpam_bayes.priors import Prior

Severity: TypeAlias = Literal["slip", "warning", "remark"]
"""A slip most likely ruins the answer; a warning is a reason not to trust a number; a remark is neither."""


class Verdict(Enum):
    """The source of a constant's value: data, prior or both; the values are those of JSON documents."""

    DATA = "determined by the data"
    BOTH = "determined by data and prior"
    PRIOR = "determined by the prior"
    MISFIT = "not determined, the model misfits"
    """The noise does not explain the misfit: what the frequencies determine is no constant of the plate."""
    UNCONVERGED = "not known, the chains did not converge"


@dataclass(frozen=True, slots=True)
class Notice:
    """A reason not to trust an answer as it stands.

    code : names its sentence in `cpam_bayes.render.notices`
    facts : what the sentence is made from, in SI or in words of the plate file
    """

    code: str
    severity: Severity = "warning"
    facts: Mapping[str, Any] = field(default_factory=dict)


def each_once(notices: Iterable[Notice]) -> tuple[Notice, ...]:
    """Equal notices of the parts of an answer once, in order."""
    found: list[Notice] = []
    for notice in notices:
        if notice not in found:
            found.append(notice)
    return tuple(found)


def as_written(texts: Iterable[str]) -> tuple[Notice, ...]:
    """Sentences of a reader of files as notices."""
    return tuple(Notice("as_written", facts={"text": text}) for text in texts)


@dataclass(frozen=True, slots=True)
class Constant:
    """An elastic constant in an answer, in SI.

    name : as inside, "E1"; of a hybrid with its material, "c.E1"
    value : the point estimate, or the mean of the posterior
    sd : standard deviation, nan where not known
    interval : 95 %, None where none can be given
    prior : what was assumed before the measurement
    reference : of the plate file, nan where it has none
    verdict : what decides the value
    bound : the bound of the prior that the value sits on
    elsewhere : values at other optima that the noise does not exclude
    rests_on : other constants whose priors the interval rests on too
    has_former_plate : whether the prior is the posterior of a former plate
    """

    name: str
    value: float
    sd: float
    interval: tuple[float, float] | None
    prior: Prior
    reference: float
    verdict: Verdict
    bound: Literal["lower", "upper"] | None = None
    elsewhere: tuple[float, ...] = ()
    rests_on: tuple[str, ...] = ()
    has_former_plate: bool = False

    @property
    def has_reference_prior(self) -> bool:
        """Whether its prior is what is known of the reference."""
        return self.prior.describe().centre == self.reference

    @property
    def is_determined(self) -> bool:
        """Whether the frequencies determine the constant."""
        return self.verdict is Verdict.DATA and not self.is_open

    @property
    def is_open(self) -> bool:
        """Whether the frequencies leave the value open, so that it must not be used."""
        held = self.bound is not None or bool(self.elsewhere) or not math.isfinite(self.sd)
        return held or self.verdict in (Verdict.PRIOR, Verdict.UNCONVERGED)


@dataclass(frozen=True, slots=True)
class FrequencyRow:
    """A measured frequency beside the model's, Hz.

    measured : None for a mode in the range of the list that the list lacks
    predicted, predicted_sd : None for a measured frequency that was paired with no mode; the sd nan where
    not known
    number : of the mode, ascending from 1, or 0
    kind : bending, in-plane or coupled; label : by nodal lines, (1,1)
    plate : name of the plate, for several
    probability : of a candidate peak, that it is what it was paired with; None of others
    """

    measured: float | None
    predicted: float | None
    kind: str | None = None
    label: str | None = None
    number: int = 0
    predicted_sd: float = math.nan
    plate: str = ""
    probability: float | None = None

    @property
    def residual(self) -> float | None:
        """Predicted / measured - 1; None where one of them is missing."""
        if self.measured is None or self.predicted is None:
            return None
        return self.predicted / self.measured - 1.0


@dataclass(frozen=True, slots=True)
class Reliance:
    """A constant whose interval rests on the prior, or the bounds, of another one.

    name : of the constant
    on : the constant whose prior it is
    widening : relative growth of the standard deviation of ``name`` were the prior of ``on`` twice as wide
    """

    name: str
    on: str
    widening: float
