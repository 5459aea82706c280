"""Two plates against each other: the differences of their constants and how sure they are."""

import json
from typing import Any

import numpy as np
import pytest

import cpam_bayes as cb
from tests.batches.plates import exact, plate, with_noise


def test_a_stiffer_plate_is_larger_by_its_ratio() -> None:
    rng = np.random.default_rng(3)
    a, b = (exact(with_noise(plate(name, e1), rng)) for name, e1 in (("a", 68.0), ("b", 71.4)))
    found = cb.compare(a, b)
    e1, nu12 = found.differences["E1"], found.differences["nu12"]
    assert abs(e1.percent - 5.0) < 3.0 * e1.sd_percent < 10.0
    assert e1.probability_larger > 0.975
    assert (e1.differs, nu12.differs) == (True, False)
    assert "b differs from a in E1 by +" in found.report().summary.headline
    # E1 goes with f^2 / h^2 of a stated density, with f^2 / h^3 of a stated mass
    assert "thickness off by 1 % changes all moduli by 2 %, of a weighed" in found.report().summary.next_step
    again = found.to_dict()["differences"]["E1_GPa"]
    assert again == {
        "percent": e1.percent,
        "sd_percent": e1.sd_percent,
        "probability_larger": e1.probability_larger,
        "determined": True,
    }


@pytest.mark.slow
def test_a_plate_does_not_differ_from_itself_and_the_order_turns_the_sign() -> None:
    rng = np.random.default_rng(4)
    a, b = with_noise(plate("a"), rng), with_noise(plate("b", 72.0), rng)
    same = cb.compare(a, a).differences["E1"]
    assert abs(same.percent) < 0.1 * same.sd_percent
    assert same.probability_larger == pytest.approx(0.5, abs=0.02)
    there, back = (cb.compare(*pair).differences["E1"] for pair in ((a, b), (b, a)))
    assert there.probability_larger + back.probability_larger == pytest.approx(1.0, abs=0.01)
    assert (1.0 + 0.01 * there.percent) * (1.0 + 0.01 * back.percent) == pytest.approx(1.0, abs=2e-3)


def test_the_command_prints_the_keys_of_the_contract(run: Any) -> None:
    status, text, _ = run("compare", "A1", "A2", "--json", "--quiet")
    assert status == 0
    assert set(json.loads(text)["differences"]) == {"E1_GPa", "nu12"}


@pytest.mark.slow
def test_plates_that_the_model_does_not_describe_are_not_compared_and_a_slip_is_named() -> None:
    good, odd = plate("good"), with_noise(plate("odd"), np.random.default_rng(4), std=0.02)
    found = cb.compare(good, odd)
    assert found.report().summary.headline.startswith("Cannot be judged")
    assert not any(d.differs for d in found.differences.values())
    clamped = plate("swapped")
    clamped["plate"]["edges"] = "CFFF"
    clamped["measurement"]["frequencies_hz"] = cb.forward(clamped, n_modes=8).frequencies.tolist()
    sizes = clamped["plate"]
    turned = {"length_mm": sizes["width_mm"], "width_mm": sizes["length_mm"]}
    headline = cb.compare(good, {**clamped, "plate": sizes | turned}).report().summary.headline
    assert headline.endswith("the frequencies of swapped (length and width exchanged?).")
