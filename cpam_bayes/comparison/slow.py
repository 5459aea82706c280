"""What takes hours: CalculiX's bricks, and posteriors over the stacking sequences of Table 9(b)."""

from __future__ import annotations

import time
from typing import Any

from cpam_bayes.comparison.store import stamp
from cpam_bayes.forward_model.solve import forward
from cpam_bayes.paper.layups import identified_layups
from cpam_bayes.paper.tables import printed_table
from cpam_bayes.result import Watch
from cpam_bayes.stacking.sequence import StackingResult, sequence

__all__ = ["calculix_frequencies", "sequence_cases"]


def calculix_frequencies(watch: Watch) -> dict[str, Any]:
    """Frequencies of the plates of Tables 1 and 5 by 20-node bricks, Hz."""
    start = time.perf_counter()
    names = dict.fromkeys(row.specimen for number in (1, 5) for row in printed_table(number).rows)
    computed = {name: forward(name, solver="ccx", watch=watch).frequencies.tolist() for name in names}
    return stamp({"seconds": time.perf_counter() - start, "frequencies_hz": computed})


def sequence_cases(seed: int, executor: str, workers: int | None, watch: Watch) -> dict[str, Any]:
    """The posterior over stacking sequences of every specimen of Table 9(b)."""
    start = time.perf_counter()
    cases = {
        name: _case(sequence(name, seed=seed, executor=executor, workers=workers, watch=watch))
        for name in identified_layups()
    }
    return stamp({"seconds": time.perf_counter() - start, "cases": cases})


def _case(result: StackingResult) -> dict[str, Any]:
    answer, given = result.answer, result.given
    assert given is not None
    return {
        "enumerated": answer.enumerated,
        "credible_95_count": answer.credible_count,
        "unaccounted": answer.unaccounted,
        "most_probable": {
            "angles_deg": answer.top[0].tolist(),
            "probability": float(answer.probability[0]),
        },
        "printed": {
            "angles_deg": given.angles_deg.tolist(),
            "probability": given.probability,
            "rank": given.rank,
            "log_evidence_below_best": float(answer.log_evidence[0] - given.log_evidence),
        },
    }
