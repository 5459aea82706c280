"""The parts of an answer: constants, frequencies, notices; made by the verbs, in SI.

Presentation is left to `cpam_bayes.render`.
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
    """The verdict on a constant: determined by data, prior or both; values as in the JSON documents."""

    DATA = "determined by the data"
    BOTH = "determined by data and prior"
    PRIOR = "determined by the prior"
    MISFIT = "not determined, the model misfits"
    """The noise does not explain the misfit: the frequencies determine no constant of the plate."""
    UNCONVERGED = "not known, the chains did not converge"


@dataclass(frozen=True, slots=True)
class Notice:
    """A reason not to trust an answer as it stands.

    code : key of its sentence in `cpam_bayes.render.notices`
    facts : values in the sentence, in SI or as named in the plate file
    """

    code: str
    severity: Severity = "warning"
    facts: Mapping[str, Any] = field(default_factory=dict)


def each_once(notices: Iterable[Notice]) -> tuple[Notice, ...]:
    """Notices without duplicates, in order."""
    found: list[Notice] = []
    for notice in notices:
        if notice not in found:
            found.append(notice)
    return tuple(found)


def as_written(texts: Iterable[str]) -> tuple[Notice, ...]:
    """Sentences from a file reader as notices."""
    return tuple(Notice("as_written", facts={"text": text}) for text in texts)


@dataclass(frozen=True, slots=True)
class Constant:
    """An elastic constant in an answer, in SI.

    name : internal name, "E1"; in a hybrid with its material, "c.E1"
    value : the point estimate, or the mean of the posterior
    sd : standard deviation, nan where not known
    interval : 95 %, None where none can be given
    prior : what was assumed before the measurement
    reference : value in the plate file, nan where it has none
    verdict : what determines the value
    bound : the bound of the prior that the value sits on
    elsewhere : values at other optima that the noise does not exclude
    rests_on : other constants whose priors the interval also depends on
    has_former_plate : whether the prior is the posterior of an earlier plate
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
        """Whether its prior is centred on the reference value."""
        return self.prior.describe().centre == self.reference

    @property
    def is_determined(self) -> bool:
        """Whether the frequencies determine the constant."""
        return self.verdict is Verdict.DATA and not self.is_open

    @property
    def is_open(self) -> bool:
        """Whether the frequencies leave the value undetermined, so that it must not be used."""
        held = self.bound is not None or bool(self.elsewhere) or not math.isfinite(self.sd)
        return held or self.verdict in (Verdict.PRIOR, Verdict.UNCONVERGED)


@dataclass(frozen=True, slots=True)
class FrequencyRow:
    """A measured frequency beside the model's, Hz.

    measured : None for a mode within the range of the list that is missing from it
    predicted, predicted_sd : None for a measured frequency paired with no mode; the sd nan where not known
    number : of the mode, ascending from 1, or 0
    kind : bending, in-plane or coupled; label : by nodal lines, (1,1)
    plate : name of the plate, where there are several
    probability : that a candidate peak is what it was paired with; None for others
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
    """A constant whose interval depends on the prior, or the bounds, of another one.

    name : of the constant
    on : the constant whose prior it is
    widening : relative growth of the standard deviation of ``name`` if the prior of ``on`` were twice as wide
    """

    name: str
    on: str
    widening: float
