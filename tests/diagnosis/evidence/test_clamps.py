"""A clamp that hardly gives is weighed, not given up: the median of its prior would be a gross error."""

import numpy as np
import pytest

from cpam_bayes.diagnosis.cases import hypotheses_of, plate_case
from cpam_bayes.diagnosis.evidence.weighing import weigh
from cpam_bayes.plate import read_plate
from tests.plate_file import described
from validation.evidence_reference import ReferenceSettings, reference_evidence

# Frequencies of bricks with an ideal clamp.
CONSTANTS = {"E1_GPa": 126.0, "E2_GPa": 8.7, "nu12": 0.3, "G12_GPa": 4.9}
CLAMPED = described(
    (262.0, 148.0, 2.4),
    1570.0,
    {"isotropic": False, **CONSTANTS, "sd": {name: 0.07 * value for name, value in CONSTANTS.items()}},
    layup="[0/90]_2s",
    edges="CFFF",
    unknowns={"E1_GPa": [80.0, 200.0], "E2_GPa": [5.0, 16.0], "nu12": [0.15, 0.45], "G12_GPa": [2.5, 10.0]},
    measurement={
        "frequencies_hz": [42.2, 81.2, 263.7, 326.6, 616.0, 731.9, 759.9, 792.5, 1126.3, 1311.0],
        "resolution_hz": 0.1,
        "relative_std": 0.002,
    },
)
SPRINGS = ("clamp_rotation", "clamp_translation", "soft_clamp")


@pytest.mark.slow
def test_springs_of_a_stiff_clamp_have_the_evidence_of_the_reference() -> None:
    case = plate_case(read_plate(CLAMPED))
    chosen = [(h, plates) for h, plates in hypotheses_of([case]) if h.cause in ("none", *SPRINGS)]
    tested = {t.hypothesis.cause: t for t in weigh([case], chosen).tested}
    assert set(tested) == {"none", *SPRINGS}
    for cause in SPRINGS:
        t = tested[cause]
        slow = reference_evidence(
            t.marginal.comparison,
            t.columns,
            0,
            ReferenceSettings(draws=1024, nodes=101, log2_points=(12, 13)),
        )
        assert slow.error < 0.1
        assert t.marginal.log_evidence == pytest.approx(slow.log_evidence, abs=0.3)
        # springs that are hardly there are the plain model, times the prior of so little of each
        least = len(t.hypothesis.parameters) * np.log(0.05)
        assert t.marginal.log_evidence - tested["none"].marginal.log_evidence > least
