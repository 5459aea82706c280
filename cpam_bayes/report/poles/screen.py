"""The screen of `poles`."""

from __future__ import annotations

from cpam_bayes.modal_analysis.poles import PolesResult
from cpam_bayes.report.sections import COMPUTATION, Section
from cpam_bayes.report.tables import facts


def sections(result: PolesResult) -> tuple[Section, ...]:
    """The stability diagram, and how the poles were found."""
    found = result.stabilisation
    rows = (
        ("files", ", ".join(result.files)),
        ("read", result.responses.origin),
        ("lines", f"{result.responses.step:.6g} Hz apart"),
        ("range", f"{result.low:.6g} to {result.high:.6g} Hz"),
        ("orders", f"1 to {result.order} poles, by sdypy-EMA (least-squares complex frequency domain)"),
        ("poles", f"{len(found.orders)}, of which {int(found.stable.sum())} are in the order below as well"),
        (
            "candidates",
            f"{len(found.candidates)} stay over many orders; {len(result.modes)} modes fitted",
        ),
    )
    return (
        Section("Stability diagram", figures=("stability",), folded=False),
        Section(COMPUTATION, (facts("Computation", rows),)),
    )
