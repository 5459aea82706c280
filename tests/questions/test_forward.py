"""`forward` beside a frequency list: by label, by order, and by a factor where units must be wrong."""

from dataclasses import replace

import pytest

from cpam_bayes.forward_model.labels import label_notices
from cpam_bayes.questions.forward import ForwardResult, forward
from cpam_bayes.render.terminal import plain_text
from tests.plate_file import described


@pytest.fixture(scope="module")
def carbon() -> ForwardResult:
    """Three modes of three labels."""
    result = forward("C1", 3)
    assert len({mode.label for mode in result.modes}) == 3
    return result


def with_list(
    result: ForwardResult, labels: tuple[str, ...], factor: float = 1.01, *, complete: bool = True
) -> ForwardResult:
    """The result beside a list of its own frequencies times a factor, in the order of the labels."""
    order = [[mode.label for mode in result.modes].index(label) if label else -1 for label in labels]
    free = iter([j for j in range(len(result.modes)) if j not in order])
    frequencies = factor * result.frequencies[[next(free) if j < 0 else j for j in order]]
    assert result.specimen.measurement is not None
    listed = replace(result.specimen.measurement, frequencies=frequencies, labels=labels, complete=complete)
    return replace(result, specimen=replace(result.specimen, measurement=listed))


def paired(result: ForwardResult) -> list[tuple[float | None, str | None]]:
    """Measured frequency over the computed one, and how the two were paired."""
    return [
        (m["measured_hz"] and round(m["measured_hz"] / m["frequency_hz"], 6), m["paired_by"])
        for m in result.to_dict()["modes"]
    ]


def test_a_label_puts_a_frequency_beside_its_mode_and_the_others_in_order(carbon: ForwardResult) -> None:
    assert paired(with_list(carbon, ("", "", ""))) == 3 * [(1.01, "order")]
    assert paired(with_list(carbon, ("", "", ""), complete=False)) == 3 * [(None, None)]
    first, second, third = (mode.label for mode in carbon.modes)
    shown = with_list(carbon, (second, first, ""))
    assert paired(shown) == [(1.01, "label"), (1.01, "label"), (1.01, "order")]
    (table,) = shown.report().summary.tables
    assert [row[-1] for row in table.rows] == ["label", "label", "order"]
    alone = with_list(carbon, (third,), complete=False)
    assert paired(alone) == [(None, None), (None, None), (1.01, "label")]
    gaps = with_list(carbon, (third, ""), complete=False)
    assert paired(gaps) == paired(alone)
    assert any("stands beside no mode" in said for said in gaps.report().summary.lines)


def test_a_label_of_no_computed_mode_is_warned_of(carbon: ForwardResult) -> None:
    shown = with_list(carbon, ("", "", ""))
    measurement = shown.specimen.measurement
    assert measurement is not None
    assert label_notices(measurement, shown.modes) == ()
    (said,) = label_notices(replace(measurement, labels=("(9,9)", "", "")), shown.modes)
    assert said.facts["labels"] == (("(9,9)", measurement.frequencies[0]),)


def test_a_difference_beyond_all_constants_is_a_factor(carbon: ForwardResult) -> None:
    for factor, said, cell in (
        (1 / 985.0, "They are 985 times the measured ones.", "985 times"),
        (1 / 1.02, "+2.0 to +2.0 %", "+2.00"),
    ):
        summary = with_list(carbon, ("", "", ""), factor).report().summary
        assert said in summary.headline
        assert cell in plain_text(summary.tables[0])


def strip(edges: str, n: int) -> ForwardResult:
    """The first modes of a slender aluminium strip."""
    material = {"isotropic": True, "E1_GPa": 70.0, "nu12": 0.0}
    return forward(described((300.0, 20.0, 2.0), 2700.0, material, edges=edges), n)


def test_a_strip_is_held_on_the_nodal_lines_of_its_first_mode_and_hit_where_all_modes_move() -> None:
    # nodes of the first mode of a free beam at 0.2242 of its length; the grid has 40 steps
    alone = strip("FFFF", 1).handling
    assert alone is not None
    (mode,) = alone.modes
    assert (mode.across, mode.lines) == ("x", pytest.approx((67.3, 232.7), abs=300 / 80))
    # the first mode moves 0.7678 of its end there
    assert mode.at_hit == pytest.approx(0.7678, abs=1e-3)
    assert sorted({x for x, _ in alone.pads}) == pytest.approx(mode.lines)
    several = strip("FFFF", 4).handling
    assert several is not None
    # at 0.05 of its length, the grid point next to the end, the fourth mode of a beam moves 0.302 of its end,
    # the first three move more; the place that was chosen is no worse
    assert min(m.at_hit for m in several.modes) >= 0.302
    assert "four soft pads" in several.sentence
    # a clamped strip needs no pads and is hit at its free end
    held = strip("CFFF", 2).handling
    assert held is not None
    assert held.pads == ()
    assert held.hits[0][0] > 270
    assert "pads" not in held.sentence


def test_thickness_mass_and_density_that_disagree_are_warned_of() -> None:
    plate = described((300.0, 200.0, 3.0), 2700.0, {"isotropic": True, "E1_GPa": 70.0, "nu12": 0.33})
    assert not forward(plate, 1).notices
    plate["plate"]["mass_g"] = 437.0  # of 486
    (said,) = forward(plate, 1).notices
    assert (said.code, said.severity) == ("thicknesses_apart", "slip")
    assert forward(plate, 1).report().summary.next_step.startswith("gauge and weigh the plate again")
    # frequencies far from the list are no sign of other units then
    plate["measurement"] = {"frequencies_hz": [4e3]}
    assert [notice.code for notice in forward(plate, 1).notices] == ["thicknesses_apart"]
    del plate["plate"]["mass_g"]
    assert [notice.code for notice in forward(plate, 1).notices] == ["units"]
