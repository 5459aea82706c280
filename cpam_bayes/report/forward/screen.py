"""The screen of `forward`."""

from __future__ import annotations

import numpy as np

from cpam_bayes.formatting import significant
from cpam_bayes.forward_model.solve import ForwardResult
from cpam_bayes.plate import Specimen, to_user, unit_of
from cpam_bayes.report.forward.rows import constants_with_origin
from cpam_bayes.report.modal_assurance.rows import assurance_sections
from cpam_bayes.report.plates.head import plate_section
from cpam_bayes.report.sections import COMPUTATION, Section
from cpam_bayes.report.tables import Table, facts, headed


def sections(result: ForwardResult) -> tuple[Section, ...]:
    """Plate, constants, mode shapes, and how exact the frequencies are."""
    worst = float(np.max(result.error))
    computation = (
        ("solver", result.solver),
        ("error", f"about {significant(100 * worst, 2)} % of a frequency in the worst mode, estimated")
        if np.isfinite(worst)
        else ("error", result.no_estimate or "no estimate"),
        ("labels", "nodal lines across x and across y; half-waves between two held edges"),
        ("time", f"{result.seconds:.1f} s"),
    )
    return (
        plate_section(result.specimen, result.air_shifts),
        Section(
            "Modes",
            (_constants(result.specimen),),
            ("modes",),
            folded=False,
        ),
        *assurance_sections(result.by_shape, result.specimen.measurement),
        Section(COMPUTATION, (facts("Computation", computation),)),
    )


def _constants(specimen: Specimen) -> Table:
    columns = headed("name", "#value", "unit", "from")
    rows = tuple(
        (name, f"{to_user(name, value):.6g}", unit_of(name), source)
        for name, value, source in constants_with_origin(specimen)
    )
    return Table("Reference constants", columns, rows)
