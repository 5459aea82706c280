"""Many plates: the same constants by shared models, failures that stop nothing, limits, charts, stores."""

import csv
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.stats import norm

import cpam_bayes as cb
from cpam_bayes.batches.geometry import carried, groups_of, size_powers
from cpam_bayes.batches.limits import MarginalPosterior, control_chart, read_limit
from cpam_bayes.batches.plate_row import PlateDiagnosis, PlateRow, computed_row, row_key, row_of
from cpam_bayes.plate import Specimen
from cpam_bayes.questions.batch.result import CERTIFICATE, BatchResult
from cpam_bayes.questions.batch.verdicts import why_not_judged
from tests.batches.plates import N_MODES, exact, plate, with_noise, written
from tests.hybrids import hybrid
from tests.plate_file import refused


def row_alone(described: dict[str, Any]) -> PlateRow:
    return computed_row("file", cb.identify(described, residuals="relative").estimate)


# Limits


def test_a_limit_is_read_in_the_unit_of_the_plate_file() -> None:
    limit = read_limit(" E1_GPa>=115 ")
    assert (limit.text, limit.name, limit.side, limit.value) == ("E1_GPa >= 115", "E1", "at least", 115e9)
    assert limit.shown == "E1 >= 115 GPa"
    below = read_limit("nu12 < 0.4")
    assert (below.text, below.side, below.value) == ("nu12 <= 0.4", "at most", 0.4)


@pytest.mark.parametrize(
    "text",
    [
        "E1 >= 115 GPa",
        "E1_GPa >= 115,0",
        "E1_GPa >= 115000 MPa",
        "E1_GPa >= 115e9Pa",
        "E1 \N{GREATER-THAN OR EQUAL TO} 115 GPa",
    ],
)
def test_a_limit_may_state_its_unit(text: str) -> None:
    limit = read_limit(text)
    assert (limit.value, limit.text) == (pytest.approx(115e9), "E1_GPa >= 115")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("E1_GPa >= 115,000 MPa", "thousands or decimals? accepted: 115000 MPa or 115 MPa"),
        ("E1_GPa >= 115000", 'write the unit if it is another one: "E1_GPa >= 115000 MPa"'),
        ("E1_GPa >= 115 psi", "the unit psi, accepted: GPa MPa Pa"),
        ("nu12 <= 0.3 GPa", "accepted: a number without a unit"),
        ("G23_GPa >= 3", "a constant that is in [unknowns] of no plate, accepted: E1_GPa"),
        *((text, "") for text in ("E >= 115", "E1_GPa 115", "E1_GPa >= ", "E1_GPa == 1", "mass_g > 1", "")),
    ],
)
def test_a_text_that_is_no_limit_is_refused_with_what_is(run: Any, text: str, said: str) -> None:
    refused(run("batch", "A1", "--limit", text), f"limit: received {text!r}", said)


def test_the_probability_of_a_limit_is_that_of_a_density_cut_at_the_bounds() -> None:
    free = MarginalPosterior(120.0, 2.0, -1e9, 1e9)
    assert free.below(117.0) == pytest.approx(norm.cdf(-1.5))
    half = MarginalPosterior(0.4, 0.1, 0.0, 0.4)  # an optimum on its upper bound
    assert half.below(0.3) == pytest.approx(2.0 * (norm.cdf(-1.0) - norm.cdf(-4.0)), rel=1e-3)
    assert (half.below(0.5), half.below(-1.0)) == (1.0, 0.0)
    limit = read_limit("nu12 >= 0.3")
    assert half.meets(limit) == pytest.approx(1.0 - half.below(0.3))


# The control chart


def test_the_control_limits_are_those_of_medians() -> None:
    """Flow rates of NIST/SEMATECH e-Handbook of Statistical Methods, 6.3.2.2."""
    flow = [49.6, 47.6, 49.9, 51.3, 47.8, 51.2, 52.6, 52.4, 53.6, 52.1]
    chart = control_chart(flow)
    assert chart is not None
    # ranges of neighbours 2.0 2.3 1.4 3.5 3.4 1.4 0.2 1.2 1.5
    assert chart.median == pytest.approx(51.25)
    assert chart.limits == pytest.approx((51.25 - 3 * 1.047 * 1.5, 51.25 + 3 * 1.047 * 1.5))
    assert chart.outside == ()
    assert control_chart(flow[:2]) is None


def test_a_normal_process_has_the_handbook_s_limits() -> None:
    chart = control_chart(np.random.default_rng(1).normal(50.0, 2.0, 20_000).tolist())
    assert chart is not None
    assert chart.sigma == pytest.approx(2.0, rel=0.03)
    assert len(chart.outside) / 20_000 == pytest.approx(0.0027, abs=0.0015)


def test_bad_plates_do_not_hide_in_the_limits_that_they_widen() -> None:
    # two of nine, side by side: limits from means, 140.9 +- 16.4, would hold one of them
    moduli = [135.2, 137.1, 136.0, 157.0, 158.1, 136.3, 135.5, 136.9, 136.8]
    chart = control_chart(moduli)
    assert chart is not None
    assert chart.outside == (3, 4)


# Shared models


def test_a_thin_plate_goes_with_its_thickness_its_density_and_its_area() -> None:
    powers = size_powers(cb.read_plate(plate("thin", thickness_mm=1.0)), N_MODES)
    thickness, density, length, width = powers.T
    np.testing.assert_allclose(thickness, 1.0, atol=2e-3)
    np.testing.assert_allclose(density, -0.5, atol=1e-9)
    # all of bending: lengths taken together have the power -2, less the shear of a plate of 1/260
    np.testing.assert_allclose(length + width, -2.0, atol=2e-3)


@pytest.mark.slow
def test_plates_of_other_sizes_have_the_constants_that_their_own_models_give() -> None:
    first = plate("first", 66.0, 0.30)
    other = plate("other", 75.0, 0.36, thickness_mm=3.12, density_kg_m3=2640.0, length_mm=302.0)
    shared = cb.batch(first, other)
    single = cb.batch(first, other, share_models=False)
    assert (shared.models, single.models) == (1, 2)
    for row, e1, nu12 in zip(shared.rows, (66.0, 75.0), (0.30, 0.36), strict=True):
        own = single.rows[shared.rows.index(row)]
        for name, true in (("E1", e1 * 1e9), ("nu12", nu12)):
            found, alone = row.constant(name), own.constant(name)
            assert found is not None
            assert alone is not None
            assert abs(found.value - alone.value) < 0.1 * alone.sd
            assert abs(found.value - true) < 0.2 * alone.sd  # the solver's error is a tenth of the noise
            assert found.sd == pytest.approx(alone.sd, rel=0.02)


def test_plates_that_differ_by_more_than_sizes_share_nothing() -> None:
    first = plate("first")
    alike = plate("alike", thickness_mm=3.05)
    thick = plate("thick", thickness_mm=3.5)
    clamped = {**first, "plate": {**first["plate"], "edges": "CFFF"}}
    labelled = {**first, "measurement": {**first["measurement"], "labels": ["(1,1)"] + [""] * (N_MODES - 1)}}
    specimens = [cb.read_plate(p) for p in (first, thick, alike, clamped, labelled, labelled)]
    assert groups_of(specimens) == [[0, 2], [1], [3], [4], [5]]


def test_a_carried_list_keeps_its_relative_noise() -> None:
    first, other = (cb.read_plate(plate("p", thickness_mm=h)) for h in (3.0, 3.1))
    moved = carried(other, first, size_powers(first, N_MODES))
    assert moved is not None
    assert moved.measurement is not None
    assert first.measurement is not None
    assert moved.plate is first.plate
    assert moved.measurement.relative_std == 0.002
    np.testing.assert_allclose(moved.measurement.frequencies, first.measurement.frequencies, rtol=2e-5)


# Laplace's approximation


def test_the_marginals_are_those_of_the_posterior_integrated_on_a_grid() -> None:
    described = with_noise(plate("noisy"), np.random.default_rng(4))
    row = row_alone(described)
    density = cb.posterior(cb.read_plate(described).with_exact_sizes())
    e = np.linspace(64e9, 76e9, 121)
    nu = np.linspace(0.15, 0.45, 121)
    x = np.stack(np.meshgrid(e, nu, indexing="ij"), axis=-1).reshape(-1, 2)
    p = np.exp(density.log_prob(x) - density.log_prob(x).max()).reshape(121, 121)
    for name, values, axis in (("E1", e, 1), ("nu12", nu, 0)):
        marginal = p.sum(axis=axis) / p.sum()
        mean = float(marginal @ values)
        sd = float(np.sqrt(marginal @ (values - mean) ** 2))
        found = row.constant(name)
        assert found is not None
        assert abs(found.posterior.centre - mean) < 0.05 * sd
        assert found.posterior.sd == pytest.approx(sd, rel=0.05)


# Failures, files, stores


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    folder, rng = tmp_path_factory.mktemp("files"), np.random.default_rng(0)
    good = [
        written(folder / f"p{i}.toml", with_noise(plate(f"p{i}", thickness_mm=h), rng))
        for i, h in enumerate((3.0, 3.02, 2.97))
    ]
    (folder / "broken.toml").write_text("[plate]\nlength_m = 3\n", encoding="utf-8")
    empty = plate("list")
    empty["measurement"]["complete"] = False
    listed = written(folder / "list.toml", empty)
    return [good[0], folder / "broken.toml", good[1], folder / "missing.toml", listed, good[2]]


@pytest.fixture(scope="module")
def good(files: list[Path]) -> list[str]:
    return [str(files[i]) for i in (0, 2, 5)]


@pytest.fixture(scope="module")
def fresh(good: list[str]) -> dict[str, Any]:
    """The document of the good plates, without what a store changes of it."""
    return without_store(cb.batch(*good))


def without_store(result: cb.Result) -> dict[str, Any]:
    return {**result.to_dict(), "seconds": 0, "from_store": 0}


def test_a_plate_that_fails_says_why_and_the_others_are_done(
    run: Any, files: list[Path], tmp_path: Path
) -> None:
    out = tmp_path / "out"
    limits = ("--limit", "E1_GPa >= 60", "--limit", "nu12 <= 0.3")
    status, text, err = run(
        "batch", *files, *limits, "--out", out, "--json", "--quiet", "--executor", "serial"
    )
    document = json.loads(text)
    assert status == 1
    assert "3 plates have no answer" in err
    rows = document["rows"]
    assert [row["status"] for row in rows] == ["done", "failed", "done", "failed", "failed", "done"]
    assert [row["file"] for row in rows] == [str(path) for path in files]
    assert "unknown key" in rows[1]["message"]
    assert "neither a file nor a built-in specimen" in rows[3]["message"]
    assert "measurement.complete: received false" in rows[4]["message"]
    for row in (rows[i] for i in (0, 2, 5)):
        e1 = row["constants"]["E1_GPa"]
        assert abs(e1["value"] - 70.0) < 4.0 * e1["sd"]
        assert row["limits"]["E1_GPa >= 60"] > 0.999
        assert 0.0 < row["limits"]["nu12 <= 0.3"] < 0.9
    assert {rows[i]["verdict"] for i in (1, 3, 4)} == {"cannot be judged"}
    for row in (rows[i] for i in (0, 2, 5)):
        p = row["limits"]["nu12 <= 0.3"]
        assert row["verdict"] == ("fail" if p <= 0.05 else "too close to call")
    table = list(csv.DictReader((out / "results.csv").read_text(encoding="utf-8-sig").splitlines()))
    assert [row["status"] for row in table] == [row["status"] for row in rows]
    assert float(table[0]["E1_GPa"]) == pytest.approx(rows[0]["constants"]["E1_GPa"]["value"], rel=1e-6)
    assert (table[1]["E1_GPa"], table[0]["P(E1_GPa >= 60)"] > "0.99") == ("", True)
    import xarray

    with xarray.open_dataset(out / "results.nc", engine="h5netcdf") as stored:
        values = stored["value"].sel(constant="E1_GPa").values
        assert list(stored["constant"].values) == ["E1_GPa", "nu12"]
        assert np.isnan(values[[1, 3, 4]]).all()
        expected = [rows[i]["constants"]["E1_GPa"]["value"] for i in (0, 2, 5)]
        np.testing.assert_allclose(values[[0, 2, 5]], expected)
        assert float(stored["probability_of_limit"][0, 0]) == rows[0]["limits"]["E1_GPa >= 60"]
    assert (out / "report.html").is_file()
    assert (out / "figures" / "control_chart.png").is_file()


@pytest.mark.slow
def test_a_stopped_batch_goes_on_and_a_damaged_row_is_computed_again(
    good: list[str], fresh: dict[str, Any], tmp_path: Path
) -> None:
    first = cb.batch(*good[:2], store=tmp_path)
    again = cb.batch(*good, store=tmp_path)
    assert (first.from_store, again.from_store) == (0, 2)
    assert without_store(again) == fresh
    kept = sorted(tmp_path.glob("*.plate"))
    assert len(kept) == 3
    content = kept[0].read_bytes()
    kept[0].write_bytes(content[:-20] + b"x" * 20)
    repaired = cb.batch(*good, store=tmp_path)
    assert repaired.from_store == 2
    assert without_store(repaired) == fresh
    assert cb.batch(good[0], store=tmp_path, seed=5).from_store == 0


@pytest.mark.slow
def test_any_number_of_workers_gives_the_same_rows(good: list[str], fresh: dict[str, Any]) -> None:
    assert without_store(cb.batch(*good, executor="processes", workers=2)) == fresh


def test_a_row_is_the_same_after_it_was_stored_and_its_key_is_of_its_plies() -> None:
    row = row_alone(plate("p"))
    assert row_of(row.stored()) == row
    assert row_key(measured(0.25, 0.375), 0, False, "") != row_key(measured(0.3, 0.3), 0, False, "")


def test_an_error_that_nobody_foresaw_is_a_row_too(monkeypatch: pytest.MonkeyPatch) -> None:
    from cpam_bayes.questions import batch as module

    def fails(*arguments: object, **options: object) -> None:
        raise ZeroDivisionError("by chance")

    monkeypatch.setattr(module, "computed_row", fails)
    result = cb.batch("A1")
    assert result.rows[0].message == "ZeroDivisionError: by chance"
    assert (result.status, result.reached_goal) == ("failed", False)
    assert result.report().summary.headline.startswith("0 of 1 ")


LIMIT = "E1_GPa >= 68"


def in_a_folder(folder: Path, described: list[dict[str, Any]]) -> str:
    for each in described:
        written(folder / f"{each['name']}.toml", each)
    return str(folder)


@pytest.mark.slow
def test_a_folder_of_plates_has_its_four_verdicts_first_and_a_certificate(tmp_path: Path) -> None:
    rng = np.random.default_rng(2)
    (tmp_path / "notes.txt").write_text("no plate", encoding="utf-8")
    plates = [with_noise(plate(f"b{i}", e1=70.0 + 0.3 * (i % 3)), rng) for i in range(4)]
    plates += [plate("b4", e1=61.0), plate("b5", e1=68.05)]
    shifted = plate("b6")
    shifted["measurement"]["frequencies_hz"][-1] *= 10.0
    plates[4]["measurement"]["left_out"] = [6]
    result = cb.batch(in_a_folder(tmp_path, list(map(exact, [*plates, shifted]))), limits=[LIMIT])
    assert [row.name for row in result.rows] == [f"b{i}" for i in range(7)]
    assert result.report().summary.headline.startswith(
        "4 pass, 1 fails (b4: thinner or softer; gauge it), "
        "1 cannot be judged (b6: a decimal point of frequency 6?), "
        "1 too close to call (b5: thinner or softer; gauge it)."
    )
    assert [row.is_judged for row in result.rows] == [True] * 6 + [False]
    page = result.texts()["certificate.html"]
    assert "the probability of meeting every limit is 0.95 or more" in page
    assert "a guard band by probability: a plate passes" in page
    assert "frequency 6 of the list, " in page
    assert "was left out by hand" in page
    used, whole = result.rows[4].constants[0], result.rows[4].all_rows[0]
    assert whole.sd < used.sd  # of six frequencies, not five
    assert "b4 with all rows" in page
    shown = f"{whole.text} GPa".replace("+-", "±").replace(" ", "\N{NO-BREAK SPACE}")
    assert f"E1: {shown}" in page
    assert "certificate.html" not in cb.batch("A1").texts()


@pytest.mark.parametrize(
    ("claim", "causes", "said"),
    [
        ("named", ("sensor_mass",), "a mass of about 7 g left on?"),
        ("class", ("sensor_mass", "outlier"), "a mass of about 7 g left on or misread frequency?"),
        ("named", ("outlier",), "frequency 9 misread?"),
        ("undecided", ("sensor_mass", "damage"), "frequency 9 misread?"),
    ],
)
def test_a_cause_that_a_diagnosis_names_is_said_before_a_slip_of_the_list(
    claim: str, causes: tuple[str, ...], said: str
) -> None:
    found = PlateDiagnosis(claim, causes, 0.95, 0.0, 0.007)
    row = PlateRow("b.toml", "b", "done", "", misfit=3.0, slip=("misread", 9), diagnosis=found)
    result = BatchResult.__new__(BatchResult)  # no limit is asked for where the model does not fit
    assert why_not_judged(result, row) == said
    assert why_not_judged(result, replace(row, slip=("sides", 0), diagnosis=None)).startswith("length and")


def test_a_certificate_ties_specimen_and_date_to_their_plate_and_says_once_what_all_share() -> None:
    tests: list[dict[str, Any]] = [
        {"specimen": "S7", "date": "2026-03-02", "operator": "A. Meyer", "laboratory": "the laboratory"},
        {"specimen": "S3", "date": "2026-03-04", "laboratory": "the laboratory"},
    ]
    plates = [{**plate(f"b{i}"), **test} for i, test in enumerate(tests)]
    result = cb.batch(*plates, "no such plate", limits=[LIMIT])
    each, common = next(s for s in result.report().sections if s.title == CERTIFICATE).tables
    assert each.headings == ("plate", "specimen", "operator", "date")
    assert each.rows == (("b0", "S7", "A. Meyer", "2026-03-02"), ("b1", "S3", "", "2026-03-04"))
    assert common.rows[0] == ("laboratory", "the laboratory")
    assert not {"specimen", "operator", "date"} & {row[0] for row in common.rows}
    alone = cb.batch(plates[0], limits=[LIMIT])
    each, common = next(s for s in alone.report().sections if s.title == CERTIFICATE).tables
    assert not each.rows
    assert common.rows[:4] == tuple(
        (key, tests[0][key]) for key in ("specimen", "laboratory", "operator", "date")
    )


def test_a_folder_without_plates_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="a folder without plate files"):
        cb.batch(tmp_path)


@pytest.mark.slow
def test_moduli_and_mass_that_go_together_are_a_thickness() -> None:
    """A weighed plate that is 4 % thinner than stated has 4 % less mass and moduli 11 to 12 % too low."""

    def weighed(name: str, e1: float, thin: float = 1.0, stated: float = 3.0) -> dict[str, Any]:
        described = plate(name, e1, thickness_mm=stated * thin)
        mass = 0.3 * 0.26 * 1e-3 * stated * thin * 2700.0 * 1e3
        described["plate"] = {**described["plate"], "thickness_mm": stated, "mass_g": mass}
        del described["plate"]["density_kg_m3"]
        return with_noise(described, np.random.default_rng(int(e1)))

    plates = [weighed(f"b{i}", 69.0 + i) for i in range(4)]
    result = cb.batch(*plates, weighed("thin", 70.0, 0.96, 3.06), limits=["E1_GPa >= 66"])
    assert "1 fails (thin: thinner by about 4 %; gauge it)" in result.report().summary.headline
    near = replace(result, limits=(read_limit("E1_GPa >= 62"),))
    assert "1 too close to call (thin: thinner by about 4 %; gauge it)" in near.report().summary.headline


def test_a_repeat_is_no_advice_where_the_thickness_decides() -> None:
    close = plate("close", e1=70.2)
    for sd, step in ((0.06, "gauge close more exactly, its thickness decides"), (0.001, "repeat the test")):
        close["plate"] = {**close["plate"], "sd": {"thickness_mm": sd, "density_kg_m3": 0.1}}
        close["measurement"] = {**close["measurement"], "relative_std": 0.002 if sd > 0.01 else 0.01}
        result = cb.batch(close, limits=["E1_GPa >= 70"])
        assert result.report().summary.next_step.startswith(step)


@pytest.mark.slow
def test_a_plate_that_misfits_is_diagnosed_unasked_and_kept(tmp_path: Path) -> None:
    odd = plate("odd")
    odd["measurement"]["frequencies_hz"][3] *= 1.01
    first = cb.batch(plate("good"), odd, store=tmp_path)
    assert first.rows[0].diagnosis is None
    assert first.rows[1].diagnosis is not None
    assert without_store(cb.batch(plate("good"), odd, store=tmp_path)) == without_store(first)


@pytest.mark.slow
def test_a_batch_with_diagnosis_has_the_claims_of_diagnose() -> None:
    quiet = with_noise(plate("quiet"), np.random.default_rng(1))
    swapped = plate("misread")
    swapped["measurement"]["frequencies_hz"][3] *= 1.06
    swapped["measurement"]["frequencies_hz"].sort()
    result = cb.batch(quiet, swapped, diagnosis=True)
    for row, described in zip(result.rows, (quiet, swapped), strict=True):
        alone = cb.diagnose(described, next_test="never")
        assert row.diagnosis is not None
        assert row.diagnosis.claim == alone.claim
        assert row.diagnosis.causes == alone.causes
        assert row.diagnosis.probability == pytest.approx(alone.probability, abs=1e-9)


@pytest.mark.slow
def test_copies_and_plates_that_are_not_described_are_named() -> None:
    rng = np.random.default_rng(4)
    good, odd = with_noise(plate("good"), rng), with_noise(plate("odd"), rng, std=0.03)
    answer = cb.batch(good, {**good, "name": "copy"}, odd)
    told = {notice.code: notice.facts["plates"] for notice in answer.notices}
    assert told["equal_lists"] == ("good", "copy")
    assert [name for name, _ in told["undescribed_plates"]] == ["odd"]
    assert [row.misfit > 1.0 for row in answer.rows] == [False, False, True]


# Hybrid plates: what is shared, and what a stored row is of


def measured(c_mm: float, g_mm: float, **plate: Any) -> Specimen:
    """A hybrid of 3 mm with plies of these thicknesses."""
    file = hybrid(**plate)
    file["ply"][0]["thickness_mm"], file["ply"][1]["thickness_mm"] = c_mm, g_mm
    file["unknowns"] = {"glass": {"E1_GPa": [20.0, 60.0]}}
    file["measurement"] = {"frequencies_hz": [109.3, 202.1, 248.2], "relative_std": 0.002}
    return cb.read_plate(file)


def test_plates_of_other_plies_share_no_model() -> None:
    same, again, other = measured(0.25, 0.375), measured(0.25, 0.375, thickness_mm=3.02), measured(0.3, 0.3)
    assert groups_of([same, again, other]) == [[0, 1], [2]]
