"""The screen of `predict`."""

from __future__ import annotations

import numpy as np

from cpam_bayes.formatting import significant, with_spread
from cpam_bayes.plate import to_user, unit_of
from cpam_bayes.prediction.predict import PredictionResult
from cpam_bayes.report.plates.head import plate_section
from cpam_bayes.report.sections import COMPUTATION, Section
from cpam_bayes.report.tables import Table, facts, headed


def sections(result: PredictionResult) -> tuple[Section, ...]:
    """Plate, posterior, mode shapes, and how exact the frequencies are."""
    worst = float(np.max(result.error))
    computation = (
        ("solver", "Ritz, first-order shear deformation, on a reduced basis"),
        ("error", f"about {significant(100.0 * worst, 2)} % of a frequency in the worst mode, estimated"),
        ("draws", str(len(result.frequencies))),
        ("time", f"{result.seconds:.1f} s"),
    )
    return (
        plate_section(result.specimen, result.air_shifts),
        Section("Predicted frequencies", (_constants(result),), ("prediction",), folded=False),
        Section("Modes", (), ("modes",), folded=False),
        Section(COMPUTATION, (facts("Computation", computation),)),
    )


def _constants(result: PredictionResult) -> Table:
    """The constants that were carried to the plate."""
    rows = []
    for name in result.posterior.constants:
        values = result.posterior.draws[name]
        mean, sd = (to_user(name, float(v)) for v in (values.mean(), values.std(ddof=1)))
        rows.append((name, *with_spread(mean, sd), unit_of(name)))
    return Table("Constants of the posterior", headed("name", "#mean", "#sd", "unit"), tuple(rows))
