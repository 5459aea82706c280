"""Figures of a diagnosis show its numbers, and the page holds them."""

from __future__ import annotations

import numpy as np
import pytest
from matplotlib.container import BarContainer, ErrorbarContainer

from cpam_bayes.diagnosis.plates import diagnosis_result
from cpam_bayes.report.diagnosis.rows import detectable_rows
from cpam_bayes.report.diagnosis.words import detectable_size
from cpam_bayes.report.figures import save_figures
from cpam_bayes.report.page import page_text, write_page
from cpam_bayes.report.tables import Column, Table
from tests.diagnosed import aluminium_case, diagnosed, listed


@pytest.fixture(scope="module")
def misread():
    factor = np.array([1.0, 1.0, 1.05, 1.0, 1.0, 1.0])
    return diagnosed([listed(aluminium_case(), factor)], ["outlier", "viscoelastic", "frequency_scale"])


@pytest.fixture(scope="module")
def result(misread):
    return diagnosis_result(misread, 0)


@pytest.fixture(scope="module")
def figures(result):
    return result.figures()


def test_bars_are_the_relative_residuals_before_and_after_with_their_noise(misread, figures):
    axes = figures["residuals"].subfigs[0].axes[0]
    bars = [c for c in axes.containers if isinstance(c, BarContainer)]
    for fit, own in zip((misread.baseline, misread.extended), bars, strict=True):
        expected = 100.0 * (fit.predicted / fit.measured - 1.0)
        assert [bar.get_height() for bar in own] == pytest.approx(expected)
    (whiskers, _) = (c for c in axes.containers if isinstance(c, ErrorbarContainer))
    fit = misread.baseline
    ends = np.array(whiskers[2][0].get_segments())[:, :, 1]
    two_sd = 200.0 * np.hypot(fit.sigma, fit.predicted_sd) / fit.measured
    assert 0.5 * np.ptp(ends, axis=1) == pytest.approx(two_sd)
    assert len(figures["residuals"].subfigs[0].axes) == 7, "a shape for each of six modes"


def test_bars_of_causes_are_their_probabilities(misread, figures):
    axes = figures["causes"].axes[0]
    widths = sorted(bar.get_width() for bar in axes.containers[0])
    assert widths == pytest.approx(sorted(cause.probability for cause in misread.causes))
    assert "named" in axes.get_title()


def test_bars_of_detectable_sizes_end_at_them(misread, figures):
    axes = figures["detectable"].axes[0]
    labels = [text.get_text() for text in axes.get_yticklabels()]
    rows = {row.cause: row for row in detectable_rows(misread)}
    assert set(labels) == set(rows)
    for label, patch in zip(labels, axes.patches, strict=True):
        if rows[label].in_sd is not None:
            assert patch.get_x() + patch.get_width() == pytest.approx(rows[label].in_sd)
    said = [text.get_text() for text in axes.texts]
    assert said == [detectable_size(rows[label]) for label in labels]
    assert "no size" in said, "a clock that is off is not seen"


def test_constants_are_drawn_beside_their_reference(misread, figures):
    panels = figures["constants"].axes
    assert [axes.get_title() for axes in panels] == ["E1, GPa", "nu12"]
    before, after = (bars.lines[0].get_ydata()[0] for bars in panels[0].containers)
    assert before == pytest.approx(misread.baseline.constants["E1"][0] / 1e9)
    assert after == pytest.approx(misread.extended.constants["E1"][0] / 1e9)
    (reference,) = [line for line in panels[0].lines if line.get_label() == "reference"]
    assert list(reference.get_ydata()) == [69.0, 69.0]


def test_a_hidden_cause_has_no_place_among_signatures(figures):
    labels = [text.get_text() for text in figures["signatures"].axes[0].get_xticklabels()]
    assert set(labels) == {"outlier", "viscoelastic"}


def test_the_page_holds_tables_and_figures_and_asks_for_nothing_else(result, figures, tmp_path):
    (tmp_path / "figures").mkdir()
    save_figures(figures, tmp_path / "figures")
    write_page("diagnose plate 7", result.tables(), tmp_path)
    text = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert text.count("<img ") == len(figures)
    assert text.count("data:image/png;base64,") == len(figures)
    assert "http" not in text
    assert "outlier" in text


def test_text_of_a_page_is_escaped():
    table = Table("a < b", (Column("x"), Column("n", number=True)), (("<script>", "1"),), frozenset({0}))
    text = page_text("D&G", [table], [])
    assert "<script>" not in text
    assert "&lt;script&gt;" in text
    assert "<title>D&amp;G</title>" in text
    assert '<tr class="flag">' in text
