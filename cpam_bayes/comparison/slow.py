"""What takes long: CalculiX's bricks, diagnoses, posteriors over the stacking sequences of Table 9(b)."""

from __future__ import annotations

import time
from typing import Any

from cpam_bayes.comparison.simulation import diagnosis_row
from cpam_bayes.comparison.store import stamp
from cpam_bayes.diagnosis.plates import diagnose
from cpam_bayes.forward_model.solve import forward
from cpam_bayes.paper.layups import identified_layups
from cpam_bayes.paper.tables import printed_table
from cpam_bayes.result import Watch
from cpam_bayes.stacking.sequence import StackingResult, sequence

__all__ = ["calculix_frequencies", "diagnoses", "sequence_cases"]


def calculix_frequencies(watch: Watch) -> dict[str, Any]:
    """Frequencies of the plates of Tables 1 and 5 by 20-node bricks, Hz, and seconds of each."""
    computed, seconds = {}, {}
    for name in dict.fromkeys(row.specimen for number in (1, 5) for row in printed_table(number).rows):
        start = time.perf_counter()
        computed[name] = forward(name, solver="ccx", watch=watch).frequencies.tolist()
        seconds[name] = time.perf_counter() - start
    return stamp({"seconds": sum(seconds.values()), "seconds_each": seconds, "frequencies_hz": computed})


def diagnoses(seed: int, watch: Watch) -> dict[str, Any]:
    """What the diagnosis says of the measured lists of Tables 1 and 4."""
    start = time.perf_counter()
    names = dict.fromkeys(row.specimen for number in (1, 4) for row in printed_table(number).rows)
    answers = {name: diagnose(name, seed=seed, next_test="never", watch=watch) for name in names}
    plates = {name: diagnosis_row(answer.to_dict()) for name, answer in answers.items()}
    return stamp({"seconds": time.perf_counter() - start, "plates": plates})


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
