"""The marginal likelihood of a damage anywhere: lists of C1 that hide one."""

from dataclasses import replace

import numpy as np
import pytest

from cpam_bayes.diagnosis.cases import hypotheses_of, plate_case
from cpam_bayes.diagnosis.comparison import PlateCase
from cpam_bayes.diagnosis.evidence.sampled import sampled_marginal
from cpam_bayes.diagnosis.evidence.scan import marginal_of
from cpam_bayes.plate import Measurement, builtin
from tests.shared import once_a_run

NOISE, N = 0.002, 10


@once_a_run
def plate() -> PlateCase:
    specimen = builtin("C1")
    listed = Measurement(np.arange(1.0, N + 1.0), 0.0, NOISE, None, ("",) * N, complete=True)
    return plate_case(replace(specimen, measurement=listed))


def hiding(form: str, damage: tuple[float, ...]) -> PlateCase:
    """The plate with a list that a damage with a depth, a place and an extent makes."""
    case = plate()
    (effect,) = (
        e for h, _ in hypotheses_of([case]) for e in h.effects if e.name == "damage" and e.local == form
    )
    x = np.concatenate((case.models.samples.x[0], damage))
    f = case.with_effect(effect).predict(x[None]).frequencies[0, :N]
    f = f * (1.0 + NOISE * np.random.default_rng(1).standard_normal(N))
    return replace(case, measurement=replace(case.measurement, frequencies=np.sort(f)))


@pytest.mark.parametrize(
    ("form", "damage", "least"),
    [
        ("bell", (0.6, 0.55, 0.7, 0.13), 100.0),
        pytest.param("rectangle", (0.45, 0.89, 0.76, 0.07), 5.0, marks=pytest.mark.slow),
        pytest.param("rectangle", (0.45, 0.93, 0.98, 0.18), 5.0, marks=pytest.mark.slow),
    ],
)
def test_a_hidden_damage_is_found_with_a_known_evidence(
    form: str, damage: tuple[float, ...], least: float
) -> None:
    case = hiding(form, damage)
    hypotheses = hypotheses_of([case])
    (plain,) = (h for h, _ in hypotheses if h.cause == "none")
    none = marginal_of([case], plain, (0,))
    for hypothesis in (h for h, _ in hypotheses if h.cause == "damage"):
        marginal = sampled_marginal(marginal_of([case], hypothesis, (0,), none=none))
        assert marginal.log_evidence - none.log_evidence > least
        assert marginal.error < 0.3
        if hypothesis.effects[0].local == form:
            mean, sd = marginal.moments()
            at = list(marginal.sizes)
            # of one list, so within three standard deviations
            assert np.all(np.abs(mean[at] - damage) < 3.0 * sd[at])
