"""Many plates: the same constants by shared models, failures that stop nothing, limits, stores, scatter."""

import csv
import json
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import pytest
import xarray
from scipy.stats import multivariate_normal, norm

import cpam_bayes as cb
from cpam_bayes.answer import Notice, Verdict
from cpam_bayes.batches.geometry import carried, groups_of, size_powers
from cpam_bayes.batches.limits import Limit, MarginalPosterior, control_chart, read_limit
from cpam_bayes.batches.plate_row import (
    LocalLikelihood,
    PlateDiagnosis,
    PlateRow,
    RowConstant,
    computed_row,
    row_key,
    row_of,
)
from cpam_bayes.batches.population import batch_posterior, population_of
from cpam_bayes.plate import Specimen
from cpam_bayes.questions import batch as module
from cpam_bayes.questions.batch.result import CERTIFICATE, BatchResult
from cpam_bayes.questions.batch.verdicts import why_not_judged
from tests.batches.plates import N_MODES, exact, plate, with_noise, written
from tests.hybrids import hybrid
from tests.plate_file import refused

T = TypeVar("T")


def known(value: T | None) -> T:
    assert value is not None
    return value


def measured(c_mm: float, g_mm: float, **plate: Any) -> Specimen:
    """A hybrid of 3 mm with plies of these thicknesses."""
    file = hybrid(**plate)
    file["ply"][0]["thickness_mm"], file["ply"][1]["thickness_mm"] = c_mm, g_mm
    file["unknowns"] = {"glass": {"E1_GPa": [20.0, 60.0]}}
    file["measurement"] = {"frequencies_hz": [109.3, 202.1, 248.2], "relative_std": 0.002}
    return cb.read_plate(file)


def without_store(result: cb.Result) -> dict[str, Any]:
    """The document of the plates, without what a store changes of it."""
    return {**result.to_dict(), "seconds": 0, "from_store": 0}


def moments(marginal: np.ndarray, values: np.ndarray) -> tuple[float, float]:
    """Mean and standard deviation of a probability on a grid."""
    mean = float(marginal @ values)
    return mean, float(np.sqrt(marginal @ (values - mean) ** 2))


# Limits


@pytest.mark.parametrize(
    "text",
    [
        " E1_GPa>=115 ",
        "E1 > 115 GPa",
        "E1_GPa >= 115,0",
        "E1_GPa >= 115000 MPa",
        "E1_GPa >= 115e9Pa",
        "E1 \N{GREATER-THAN OR EQUAL TO} 115 GPa",
    ],
)
def test_a_limit_is_read_in_the_unit_of_the_plate_file_or_its_own(text: str) -> None:
    limit = read_limit(text)
    assert replace(limit, value=115e9) == Limit("E1_GPa >= 115", "E1", "at least", 115e9)
    assert (limit.value, limit.shown) == (pytest.approx(115e9), "E1 >= 115 GPa")
    assert read_limit("nu12 < 0.4") == Limit("nu12 <= 0.4", "nu12", "at most", 0.4)


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


def test_the_control_limits_are_those_of_medians_and_three_standard_deviations() -> None:
    """Flow rates of NIST/SEMATECH e-Handbook of Statistical Methods, 6.3.2.2."""
    flow = [49.6, 47.6, 49.9, 51.3, 47.8, 51.2, 52.6, 52.4, 53.6, 52.1]
    chart = known(control_chart(flow))
    # ranges of neighbours 2.0 2.3 1.4 3.5 3.4 1.4 0.2 1.2 1.5
    assert chart.median == pytest.approx(51.25)
    assert chart.limits == pytest.approx((51.25 - 3 * 1.047 * 1.5, 51.25 + 3 * 1.047 * 1.5))
    assert chart.outside == ()
    assert control_chart(flow[:2]) is None
    # two bad ones of nine, side by side: limits from means, 140.9 +- 16.4, would hold one of them
    moduli = [135.2, 137.1, 136.0, 157.0, 158.1, 136.3, 135.5, 136.9, 136.8]
    assert known(control_chart(moduli)).outside == (3, 4)
    normal = known(control_chart(np.random.default_rng(1).normal(50.0, 2.0, 20_000).tolist()))
    assert normal.sigma == pytest.approx(2.0, rel=0.03)
    assert len(normal.outside) / 20_000 == pytest.approx(0.0027, abs=0.0015)


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
    for row, own, *true_values in zip(shared.rows, single.rows, (66e9, 75e9), (0.30, 0.36), strict=True):
        for name, true in zip(("E1", "nu12"), true_values, strict=True):
            found, alone = known(row.constant(name)), known(own.constant(name))
            assert abs(found.value - alone.value) < 0.1 * alone.sd
            assert abs(found.value - true) < 0.2 * alone.sd  # the solver's error is a tenth of the noise
            assert found.sd == pytest.approx(alone.sd, rel=0.02)


def test_plates_that_differ_by_more_than_sizes_share_no_model_and_no_stored_row() -> None:
    first = plate("first")
    alike = plate("alike", thickness_mm=3.05)
    thick = plate("thick", thickness_mm=3.5)
    clamped = {**first, "plate": {**first["plate"], "edges": "CFFF"}}
    labelled = {**first, "measurement": {**first["measurement"], "labels": ["(1,1)"] + [""] * (N_MODES - 1)}}
    specimens = [cb.read_plate(p) for p in (first, thick, alike, clamped, labelled, labelled)]
    plies = [measured(0.25, 0.375), measured(0.25, 0.375, thickness_mm=3.02), measured(0.3, 0.3)]
    assert groups_of([*specimens, *plies]) == [[0, 2], [1], [3], [4], [5], [6, 7], [8]]
    weighed = [measured(c, g, mass_g=310.0) for c, g in ((0.25, 0.375), (0.3, 0.3))]  # of one density
    assert len({row_key(plate, 0, False, "") for plate in weighed}) == 2


def test_a_carried_list_keeps_its_relative_noise() -> None:
    first, other = (cb.read_plate(plate("p", thickness_mm=h)) for h in (3.0, 3.1))
    moved = known(carried(other, first, size_powers(first, N_MODES)))
    found, expected = known(moved.measurement), known(first.measurement)
    assert moved.plate is first.plate
    assert found.relative_std == 0.002
    np.testing.assert_allclose(found.frequencies, expected.frequencies, rtol=2e-5)


# Laplace's approximation


def test_the_marginals_of_a_row_that_was_stored_are_those_of_the_posterior_on_a_grid() -> None:
    described = with_noise(plate("noisy"), np.random.default_rng(4))
    computed = computed_row("file", cb.identify(described, residuals="relative").estimate)
    row = row_of(computed.stored())
    assert row == computed
    density = cb.posterior(cb.read_plate(described).with_exact_sizes())
    e = np.linspace(64e9, 76e9, 121)
    nu = np.linspace(0.15, 0.45, 121)
    x = np.stack(np.meshgrid(e, nu, indexing="ij"), axis=-1).reshape(-1, 2)
    p = np.exp(density.log_prob(x) - density.log_prob(x).max()).reshape(121, 121)
    for name, values, axis in (("E1", e, 1), ("nu12", nu, 0)):
        mean, sd = moments(p.sum(axis=axis) / p.sum(), values)
        found = known(row.constant(name)).posterior
        assert abs(found.centre - mean) < 0.05 * sd
        assert found.sd == pytest.approx(sd, rel=0.05)


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
    assert {rows[i]["verdict"] for i in (1, 3, 4)} == {"cannot be judged"}
    for row in (rows[i] for i in (0, 2, 5)):
        e1, p = row["constants"]["E1_GPa"], row["limits"]["nu12 <= 0.3"]
        assert abs(e1["value"] - 70.0) < 4.0 * e1["sd"]
        assert row["limits"]["E1_GPa >= 60"] > 0.999
        assert 0.0 < p < 0.9
        assert row["verdict"] == ("fail" if p <= 0.05 else "too close to call")
    table = list(csv.DictReader((out / "results.csv").read_text(encoding="utf-8-sig").splitlines()))
    assert [row["status"] for row in table] == [row["status"] for row in rows]
    assert float(table[0]["E1_GPa"]) == pytest.approx(rows[0]["constants"]["E1_GPa"]["value"], rel=1e-6)
    assert (table[1]["E1_GPa"], table[0]["P(E1_GPa >= 60)"] > "0.99") == ("", True)
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
def test_a_stopped_batch_goes_on_with_any_workers_and_a_damaged_row_is_computed_again(
    files: list[Path], tmp_path: Path
) -> None:
    good = [files[i] for i in (0, 2, 5)]
    fresh = without_store(cb.batch(*good))
    first = cb.batch(*good[:2], store=tmp_path, executor="processes", workers=2)
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


def test_an_error_that_nobody_foresaw_is_a_row_too(monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(*arguments: object, **options: object) -> None:
        raise ZeroDivisionError("by chance")

    monkeypatch.setattr(module, "computed_row", fails)
    result = cb.batch("A1")
    assert result.rows[0].message == "ZeroDivisionError: by chance"
    assert (result.status, result.reached_goal) == ("failed", False)
    assert result.report().summary.headline.startswith("0 of 1 ")


LIMIT = "E1_GPa >= 68"


@pytest.mark.slow
def test_a_folder_of_plates_has_its_four_verdicts_first_and_a_certificate(tmp_path: Path) -> None:
    rng = np.random.default_rng(2)
    (tmp_path / "notes.txt").write_text("no plate", encoding="utf-8")
    plates = [with_noise(plate(f"b{i}", e1=70.0 + 0.3 * (i % 3)), rng) for i in range(4)]
    plates += [plate("b4", e1=61.0), plate("b5", e1=68.05)]
    shifted = plate("b6")
    shifted["measurement"]["frequencies_hz"][-1] *= 10.0
    plates[4]["measurement"]["left_out"] = [6]
    for each in [*plates, shifted]:
        written(tmp_path / f"{each['name']}.toml", exact(each))
    result = cb.batch(tmp_path, limits=[LIMIT])
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
def test_copies_are_named_and_a_plate_that_misfits_is_diagnosed_unasked_and_kept(tmp_path: Path) -> None:
    good, odd = plate("good"), plate("odd")
    odd["measurement"]["frequencies_hz"][3] *= 1.01
    first, again = (cb.batch(good, {**good, "name": "copy"}, odd, store=tmp_path) for _ in range(2))
    assert [row.misfit > 1.0 for row in first.rows] == [False, False, True]
    assert [row.diagnosis is not None for row in first.rows] == [False, False, True]
    told = {notice.code: notice.facts["plates"] for notice in first.notices}
    assert told["equal_lists"] == ("good", "copy")
    assert [name for name, _ in told["undescribed_plates"]] == ["odd"]
    assert without_store(again) == without_store(first)


def test_plates_whose_files_contradict_themselves_are_named() -> None:
    wrong = plate("wrong")
    wrong["plate"]["mass_g"] = 10.0
    result = cb.batch(wrong)
    assert result.notices[1] == Notice("disagreeing_plates", "slip", {"plates": ("wrong",)})
    (row,) = result.rows
    assert "mass over density" in row.message
    assert "likely slip" not in row.message


@pytest.mark.slow
@pytest.mark.weekly
def test_a_batch_with_diagnosis_has_the_claims_of_diagnose() -> None:
    quiet = with_noise(plate("quiet"), np.random.default_rng(1))
    swapped = plate("misread")
    swapped["measurement"]["frequencies_hz"][3] *= 1.06
    swapped["measurement"]["frequencies_hz"].sort()
    result = cb.batch(quiet, swapped, diagnosis=True)
    for row, described in zip(result.rows, (quiet, swapped), strict=True):
        alone = cb.diagnose(described, next_test="never")
        found = known(row.diagnosis)
        assert (found.claim, found.causes) == (alone.claim, alone.causes)
        assert found.probability == pytest.approx(alone.probability, abs=1e-9)


# Mean and scatter of the material


def likelihood(at: Any, information: Any, gradient: Any = None) -> LocalLikelihood:
    at, information = np.atleast_1d(at), np.atleast_2d(information)
    g = np.zeros(len(at)) if gradient is None else np.atleast_1d(gradient)
    names = ("E1", "E2", "nu12", "G12")[: len(at)]
    return LocalLikelihood(names, tuple(at), tuple(g), tuple(map(tuple, information)))


def row(number: int, local: LocalLikelihood) -> PlateRow:
    constants = tuple(
        RowConstant(name, v, 1.0, 0.0, 1.0, Verdict.DATA, MarginalPosterior(v, 1.0, 0.0, 200.0))
        for name, v in zip(local.names, local.at, strict=True)
    )
    return PlateRow(f"p{number}", f"p{number}", "done", "", "carbon", constants, local)


def test_the_likelihood_is_the_gaussian_of_both_scatters_together() -> None:
    """N(at; mu, T + F^-1) over the integral of exp(-1/2 d F d), and the same with a slope at the optimum."""
    rng = np.random.default_rng(2)
    a = rng.standard_normal((3, 3))
    f = a @ a.T + np.eye(3)
    at, g = np.array([5.0, 2.0, 1.0]), np.array([0.3, -0.2, 0.1])
    density = batch_posterior([likelihood(at, f, g)], [(0.0, 50.0)] * 3)
    for _ in range(5):
        mean, scatter = at * rng.uniform(0.8, 1.2, 3), rng.uniform(1e-4, 0.4, 3)
        x = np.concatenate((mean / density.scale, scatter))
        tau = scatter * density.scale
        peak = at + np.linalg.solve(f, g)
        expected = (
            multivariate_normal(mean, np.diag(tau**2) + np.linalg.inv(f)).logpdf(peak)
            + 1.5 * np.log(2.0 * np.pi)
            - 0.5 * np.linalg.slogdet(f)[1]
            + 0.5 * g @ np.linalg.solve(f, g)
        )
        assert density.log_likelihood(x[None])[0] == pytest.approx(expected, rel=1e-9)


def test_the_chains_have_the_posterior_that_a_grid_gives() -> None:
    rng = np.random.default_rng(5)
    own = 1.5
    values = 100.0 + 3.0 * rng.standard_normal(12) + own * rng.standard_normal(12)
    each = [likelihood(v, own**-2.0) for v in values]
    population = population_of([row(i, local) for i, local in enumerate(each)], seed=0)
    (found,) = population.constants
    density = batch_posterior(each, [(0.0, 200.0)])
    mean = np.linspace(0.93, 1.07, 241)
    scatter = np.linspace(1e-4, 0.16, 321)
    x = np.stack(np.meshgrid(mean, scatter, indexing="ij"), axis=-1).reshape(-1, 2)
    log_p = density.log_prob(x)
    p = np.exp(log_p - log_p.max()).reshape(len(mean), len(scatter))
    p /= p.sum()
    for values_of, marginal, (m, sd, low, high) in (
        (mean * density.scale[0], p.sum(axis=1), found.mean),
        (scatter, p.sum(axis=0), found.scatter),
    ):
        expected, spread = moments(marginal, values_of)
        # a thousand effective draws know a mean to 3 % of the spread, a quantile to some 6 %
        assert m == pytest.approx(expected, abs=0.12 * spread)
        assert sd == pytest.approx(spread, rel=0.12)
        cumulative = np.cumsum(marginal)
        for quantile, level in ((low, 0.025), (high, 0.975)):
            assert quantile == pytest.approx(np.interp(level, cumulative, values_of), abs=0.25 * spread)
    assert population.status == "converged"
    wide = np.hypot(found.mean[1], found.scatter[0] * 100.0)
    assert found.next_plate[1] == pytest.approx(wide, rel=0.15)


def test_plates_that_do_not_scatter_have_a_small_one_and_open_constants_the_prior() -> None:
    rng = np.random.default_rng(3)
    information = np.diag([1.0, 0.0])  # E1 to 1 of 100, nothing about the other
    rows = [row(i, likelihood([100.0 + rng.standard_normal(), 50.0], information)) for i in range(25)]
    e1, e2 = population_of(rows, seed=0).constants
    assert e1.scatter[3] < 0.015
    # half a Student-t of 5 % and four degrees of freedom has its median at 3.7 %, its mean at 5 %
    assert e2.scatter[0] == pytest.approx(0.049, abs=0.008)
    assert e2.mean[1] == pytest.approx(200.0 / np.sqrt(12.0), rel=0.1)


@pytest.mark.slow
def test_lists_of_simulated_plates_give_the_constants_of_their_material() -> None:
    rng = np.random.default_rng(1)
    moduli = 70.0 * (1.0 + 0.03 * rng.standard_normal(8))
    plates = [with_noise(plate(f"p{i}", e1=e), rng) for i, e in enumerate(moduli)]
    result, again = (cb.batch(*plates, hierarchical=True) for _ in range(2))
    population = known(result.population)
    e1 = population.constants[0]
    assert abs(e1.mean[0] / 1e9 - moduli.mean()) < 3.0 * e1.mean[1] / 1e9
    assert e1.scatter[2] < 0.03 < e1.scatter[3]
    np.testing.assert_array_equal(known(again.population).draws, population.draws)
    document = result.to_dict()["population"]["constants"]["E1_GPa"]
    assert document["mean"]["mean"] == pytest.approx(e1.mean[0] / 1e9)
    assert document["scatter_percent"]["mean"] == pytest.approx(100.0 * e1.scatter[0])
    assert "The material" in result.summary()


def test_a_batch_that_has_no_scatter_says_why_and_keeps_its_rows(run: Any) -> None:
    status, out, err = run("batch", "A1", "A1", "--hierarchical", "--quiet", "--executor", "serial")
    assert status == 1
    assert "2 plates have an answer, a scatter needs 3 or more" in err
    assert "A1" in out
    two = [row(i, likelihood(70.0, 1.0)) for i in range(3)]
    other = PlateRow("q", "q", "done", "", "glass", two[0].constants, two[0].likelihood)
    with pytest.raises(ValueError, match="several materials: carbon, glass"):
        population_of([*two, other], seed=0)
    with pytest.raises(ValueError, match="different unknown constants"):
        population_of([*two, row(4, likelihood([70.0, 0.3], np.eye(2)))], seed=0)
