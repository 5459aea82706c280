"""Figures of a diagnosis show its numbers, and their titles agree with them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.container import BarContainer, ErrorbarContainer

from cpam_bayes.diagnosis.claim import Claim
from cpam_bayes.diagnosis.plates import diagnosis_result
from cpam_bayes.report.diagnosis.rows import detectable_rows
from cpam_bayes.report.diagnosis.words import detectable_size
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
    assert axes.get_title() == "plate 7: claimed is outlier"
    (needed,) = (line for line in axes.lines if line.get_label() == "needed for a claim")
    labels = [text.get_text() for text in axes.get_yticklabels()]
    claims = dict(zip(labels, needed.get_xdata(), strict=True))
    assert claims.pop("none") == 0.5
    assert set(claims.values()) == {0.9}


def test_a_claim_that_nothing_is_wrong_is_no_claim_of_a_cause(misread):
    title = {
        claim.kind: diagnosis_result(replace(misread, claim=claim), 0).plot("causes").axes[0].get_title()
        for claim in (
            Claim("none", (), 0.6),
            Claim("class", ("outlier", "viscoelastic"), 0.95),
            Claim("undecided", ("outlier",), 0.4),
        )
    }
    assert title["none"] == "plate 7: no cause is claimed"
    assert title["class"] == "plate 7: claimed is one of outlier or viscoelastic"
    assert title["undecided"] == "plate 7: undecided, no cause is claimed"


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
