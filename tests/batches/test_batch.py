"""Many plates: shared models, failures that stop nothing, limits, stores, scatter; two plates compared."""

import csv
import json
from dataclasses import replace

import numpy as np
import pytest
import xarray
from scipy.stats import multivariate_normal, norm

import cpam_bayes as cb
from cpam_bayes.answer import Notice, Verdict
from cpam_bayes.batches import plate_row
from cpam_bayes.batches.geometry import carried, groups_of, size_powers
from cpam_bayes.batches.limits import Limit, MarginalPosterior, control_chart, read_limit
from cpam_bayes.batches.plate_row import computed_row, row_key, row_of
from cpam_bayes.batches.population import batch_posterior, population_of
from cpam_bayes.questions import batch as module
from cpam_bayes.questions.batch.result import CERTIFICATE, BatchResult
from cpam_bayes.questions.batch.verdicts import why_not_judged
from tests.batches.plates import N_MODES, exact, plate, with_noise, written
from tests.hybrids import hybrid
from tests.plate_file import refused
from tests.posteriors import write_posterior


def measured(c_mm, g_mm, **plate):
    file = hybrid(**plate)
    file["ply"][0]["thickness_mm"], file["ply"][1]["thickness_mm"] = c_mm, g_mm
    listed = {"frequencies_hz": [109.3, 202.1, 248.2], "relative_std": 0.002}
    return cb.read_plate({**file, "unknowns": {"glass": {"E1_GPa": [20.0, 60.0]}}, "measurement": listed})


def without_store(result):
    return {**result.to_dict(), "seconds": 0, "from_store": 0}


def moments(marginal, values):
    mean = float(marginal @ values)
    return mean, float(np.sqrt(marginal @ (values - mean) ** 2))


def on_grid(density, *axes):
    x = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    log_p = density.log_prob(x.reshape(-1, 2))
    p = np.exp(log_p - log_p.max()).reshape(x.shape[:2])
    return p / p.sum()


@pytest.mark.parametrize(
    "text",
    [
        *(" E1_GPa>=115 ", "E1 > 115 GPa", "E1_GPa >= 115,0", "E1_GPa >= 115000 MPa", "E1_GPa >= 115e9Pa"),
        "E1 \N{GREATER-THAN OR EQUAL TO} 115 GPa",
    ],
)
def test_a_limit_is_read_in_the_unit_of_the_plate_file_or_its_own(text):
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
        ("G23_GPa >= 3", "a constant in no plate's [unknowns], accepted: E1_GPa"),
        *((text, "") for text in ("E >= 115", "E1_GPa 115", "E1_GPa >= ", "E1_GPa == 1", "mass_g > 1", "")),
    ],
)
def test_a_text_that_is_no_limit_is_refused_with_what_is(run, text, said):
    refused(run("batch", "A1", "--limit", text), f"limit: received {text!r}", said)


def test_the_probability_of_a_limit_is_that_of_a_density_cut_at_the_bounds():
    assert MarginalPosterior(120.0, 2.0, -1e9, 1e9).below(117.0) == pytest.approx(norm.cdf(-1.5))
    half = MarginalPosterior(0.4, 0.1, 0.0, 0.4)  # an optimum on its upper bound
    assert half.below(0.3) == pytest.approx(2.0 * (norm.cdf(-1.0) - norm.cdf(-4.0)), rel=1e-3)
    assert (half.below(0.5), half.below(-1.0)) == (1.0, 0.0)
    assert half.meets(read_limit("nu12 >= 0.3")) == pytest.approx(1.0 - half.below(0.3))


def test_the_control_limits_are_those_of_medians_and_three_standard_deviations():
    """Flow rates of NIST/SEMATECH e-Handbook of Statistical Methods, 6.3.2.2."""
    flow = [49.6, 47.6, 49.9, 51.3, 47.8, 51.2, 52.6, 52.4, 53.6, 52.1]
    chart = control_chart(flow)
    assert chart.median == pytest.approx(51.25)  # moving ranges 2.0 2.3 1.4 3.5 3.4 1.4 0.2 1.2 1.5
    assert chart.limits == pytest.approx((51.25 - 3 * 1.0484 * 1.5, 51.25 + 3 * 1.0484 * 1.5))
    assert (chart.outside, control_chart(flow[:2])) == ((), None)
    # two bad ones of nine, adjacent: limits from means, 140.9 +- 16.4, would include one of them
    moduli = [135.2, 137.1, 136.0, 157.0, 158.1, 136.3, 135.5, 136.9, 136.8]
    assert control_chart(moduli).outside == (3, 4)
    normal = control_chart(np.random.default_rng(1).normal(50.0, 2.0, 20_000).tolist())
    assert normal.sigma == pytest.approx(2.0, rel=0.03)
    assert len(normal.outside) / 20_000 == pytest.approx(0.0027, abs=0.0015)


def test_a_thin_plate_goes_with_its_thickness_its_density_and_its_area_and_carries_its_relative_noise():
    powers = size_powers(cb.read_plate(plate("thin", thickness_mm=1.0)), N_MODES)
    thickness, density, length, width = powers.T
    np.testing.assert_allclose(thickness, 1.0, atol=2e-3)
    np.testing.assert_allclose(density, -0.5, atol=1e-9)
    np.testing.assert_allclose(length + width, -2.0, atol=2e-3)  # bending minus the shear of a plate of 1/260
    first, other = (cb.read_plate(plate("p", thickness_mm=h)) for h in (3.0, 3.1))
    moved = carried(other, first, size_powers(first, N_MODES))
    assert moved.measurement.relative_std == 0.002
    assert moved.plate is first.plate
    np.testing.assert_allclose(moved.measurement.frequencies, first.measurement.frequencies, rtol=2e-5)


@pytest.mark.slow
def test_plates_of_other_sizes_have_the_constants_that_their_own_models_give():
    first = plate("first", 66.0, 0.30)
    other = plate("other", 75.0, 0.36, thickness_mm=3.12, density_kg_m3=2640.0, length_mm=302.0)
    shared, single = (cb.batch(first, other, share_models=share) for share in (True, False))
    assert (shared.models, single.models) == (1, 2)
    for row, own, *true_values in zip(shared.rows, single.rows, (66e9, 75e9), (0.30, 0.36), strict=True):
        for name, true in zip(("E1", "nu12"), true_values, strict=True):
            found, alone = row.constant(name), own.constant(name)
            assert abs(found.value - alone.value) < 0.1 * alone.sd
            assert abs(found.value - true) < 0.2 * alone.sd  # the solver's error is a tenth of the noise
            assert found.sd == pytest.approx(alone.sd, rel=0.02)


def test_plates_that_differ_by_more_than_sizes_share_no_model_and_no_stored_row():
    first, alike, thick = (plate("p", thickness_mm=h) for h in (3.0, 3.05, 3.5))
    clamped = {**first, "plate": {**first["plate"], "edges": "CFFF"}}
    labelled = {**first, "measurement": {**first["measurement"], "labels": ["(1,1)"] + [""] * (N_MODES - 1)}}
    specimens = [cb.read_plate(p) for p in (first, thick, alike, clamped, labelled, labelled)]
    plies = [measured(0.25, 0.375), measured(0.25, 0.375, thickness_mm=3.02), measured(0.3, 0.3)]
    assert groups_of([*specimens, *plies]) == [[0, 2], [1], [3], [4], [5], [6, 7], [8]]
    weighed = [measured(c, g, mass_g=310.0) for c, g in ((0.25, 0.375), (0.3, 0.3))]  # of equal density
    assert len({row_key(plate, 0, False, "") for plate in weighed}) == 2


def test_the_marginals_of_a_row_that_was_stored_are_those_of_the_posterior_on_a_grid():
    described = with_noise(plate("noisy"), np.random.default_rng(4))
    computed = computed_row("file", cb.identify(described, residuals="relative").estimate)
    row = row_of(computed.stored())
    assert row == computed
    density = cb.posterior(cb.read_plate(described).with_exact_sizes())
    e, nu = np.linspace(64e9, 76e9, 121), np.linspace(0.15, 0.45, 121)
    p = on_grid(density, e, nu)
    for name, values, axis in (("E1", e, 1), ("nu12", nu, 0)):
        mean, sd = moments(p.sum(axis=axis), values)
        found = row.constant(name).posterior
        assert abs(found.centre - mean) < 0.05 * sd
        assert found.sd == pytest.approx(sd, rel=0.05)


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder, rng = tmp_path_factory.mktemp("files"), np.random.default_rng(0)
    plates = [with_noise(plate(f"p{i}", thickness_mm=h), rng) for i, h in enumerate((3.0, 3.02, 2.97))]
    one, two, three = (written(folder / f"{each['name']}.toml", each) for each in plates)
    broken = folder / "broken.toml"
    broken.write_text("[plate]\nlength_m = 3\n", encoding="utf-8")
    gaps = plate("list")
    gaps["measurement"]["complete"] = False
    return [one, broken, two, folder / "missing.toml", written(folder / "list.toml", gaps), three]


def test_a_plate_that_fails_says_why_and_the_others_are_done(run, files, tmp_path):
    out, done, failed = tmp_path / "out", [0, 2, 5], [1, 3, 4]
    limits = ("--limit", "E1_GPa >= 60", "--limit", "nu12 <= 0.3")
    asked = ("batch", *files, *limits, "--json", "--quiet", "--executor", "serial", "--out", out)
    status, text, err = run(*asked)
    assert status == 1
    assert "3 plates have no answer" in err
    rows = json.loads(text)["rows"]
    states = [row["status"] for row in rows]
    assert states == ["done", "failed", "done", "failed", "failed", "done"]
    assert [row["file"] for row in rows] == [str(path) for path in files]
    assert "unknown key" in rows[1]["message"]
    assert "neither a file nor a built-in specimen" in rows[3]["message"]
    assert "measurement.complete: received false" in rows[4]["message"]
    assert {rows[i]["verdict"] for i in failed} == {"cannot be judged"}
    for row in (rows[i] for i in done):
        e1, p = row["constants"]["E1_GPa"], row["limits"]["nu12 <= 0.3"]
        assert abs(e1["value"] - 70.0) < 4.0 * e1["sd"]
        assert row["limits"]["E1_GPa >= 60"] > 0.999
        assert 0.0 < p < 0.9
        assert row["verdict"] == ("fail" if p <= 0.05 else "too close to call")
    expected = [rows[i]["constants"]["E1_GPa"]["value"] for i in done]
    table = list(csv.DictReader((out / "results.csv").read_text(encoding="utf-8-sig").splitlines()))
    assert [row["status"] for row in table] == states
    assert float(table[0]["E1_GPa"]) == pytest.approx(expected[0], rel=1e-6)
    assert (table[1]["E1_GPa"], table[0]["P(E1_GPa >= 60)"] > "0.99") == ("", True)
    with xarray.open_dataset(out / "results.nc", engine="h5netcdf") as stored:
        assert list(stored["constant"].values) == ["E1_GPa", "nu12"]
        values = stored["value"].sel(constant="E1_GPa").values
        assert np.isnan(values[failed]).all()
        np.testing.assert_allclose(values[done], expected)
        assert float(stored["probability_of_limit"][0, 0]) == rows[0]["limits"]["E1_GPa >= 60"]
    assert (out / "report.html").is_file()
    assert (out / "figures" / "control_chart.png").is_file()


@pytest.mark.slow
def test_a_stopped_batch_goes_on_with_any_workers_and_a_damaged_row_is_computed_again(files, tmp_path):
    good = [files[i] for i in (0, 2, 5)]
    fresh = without_store(cb.batch(*good))
    first = cb.batch(*good[:2], store=tmp_path, executor="processes", workers=2)
    again = cb.batch(*good, store=tmp_path)
    assert (first.from_store, again.from_store) == (0, 2)
    assert without_store(again) == fresh
    damaged, *others = sorted(tmp_path.glob("*.plate"))
    assert len(others) == 2
    damaged.write_bytes(damaged.read_bytes()[:-20] + b"x" * 20)
    repaired = cb.batch(*good, store=tmp_path)
    assert (repaired.from_store, without_store(repaired)) == (2, fresh)
    assert cb.batch(good[0], store=tmp_path, seed=5).from_store == 0


LIMIT = "E1_GPa >= 68"


@pytest.mark.slow
def test_a_folder_of_plates_has_its_four_verdicts_first_and_a_certificate(tmp_path):
    rng = np.random.default_rng(2)
    (tmp_path / "notes.txt").write_text("no plate", encoding="utf-8")
    plates = [with_noise(plate(f"b{i}", e1=70.0 + 0.3 * (i % 3)), rng) for i in range(4)]
    plates += [plate("b4", e1=61.0), plate("b5", e1=68.05), plate("b6")]
    plates[6]["measurement"]["frequencies_hz"][-1] *= 10.0
    plates[4]["measurement"]["left_out"] = [6]
    for each in plates:
        written(tmp_path / f"{each['name']}.toml", exact(each))
    result = cb.batch(tmp_path, limits=[LIMIT])
    assert [row.name for row in result.rows] == [f"b{i}" for i in range(7)]
    assert [row.is_judged for row in result.rows] == [True] * 6 + [False]
    assert result.report().summary.headline.startswith(
        "4 pass, 1 fail (b4: thinner or softer; gauge it), "
        "1 cannot be judged (b6: a decimal point of frequency 6?), "
        "1 too close to call (b5: thinner or softer; gauge it)."
    )
    page, row = result.texts()["certificate.html"], result.rows[4]
    used, whole = row.constants[0], row.all_rows[0]
    assert whole.sd < used.sd  # six frequencies, not five
    shown = f"{whole.text} GPa".replace("+-", "±").replace(" ", "\N{NO-BREAK SPACE}")
    for part in (
        "the probability of meeting every limit is 0.95 or more",
        "a guard band by probability: a plate passes",
        "frequency 6 of the list, ",
        "was left out by hand",
        "b4 with all rows",
        f"E1: {shown}",
    ):
        assert part in page
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
def test_a_cause_that_a_diagnosis_names_is_said_before_a_slip_of_the_list(claim, causes, said):
    found = plate_row.PlateDiagnosis(claim, causes, 0.95, 0.0, 0.007)
    row = plate_row.PlateRow("b.toml", "b", "done", "", misfit=3.0, slip=("misread", 9), diagnosis=found)
    result = BatchResult.__new__(BatchResult)  # no limit is needed where the model does not fit
    assert why_not_judged(result, row) == said
    assert why_not_judged(result, replace(row, slip=("sides", 0), diagnosis=None)).startswith("length and")


def certificate(result):
    return next(s for s in result.report().sections if s.title == CERTIFICATE).tables


def test_a_certificate_ties_specimen_and_date_to_their_plate_and_says_once_what_all_share():
    first = {"specimen": "S7", "laboratory": "the laboratory", "operator": "A. Meyer", "date": "2026-03-02"}
    second = {"specimen": "S3", "date": "2026-03-04", "laboratory": "the laboratory"}
    plates = [{**plate(f"b{i}"), **test} for i, test in enumerate((first, second))]
    each, common = certificate(cb.batch(*plates, "no such plate", limits=[LIMIT]))
    assert each.headings == ("plate", "specimen", "operator", "date")
    assert each.rows == (("b0", "S7", "A. Meyer", "2026-03-02"), ("b1", "S3", "", "2026-03-04"))
    assert common.rows[0] == ("laboratory", "the laboratory")
    assert not {"specimen", "operator", "date"} & {row[0] for row in common.rows}
    each, common = certificate(cb.batch(plates[0], limits=[LIMIT]))
    assert (each.rows, common.rows[:4]) == ((), tuple(first.items()))


@pytest.mark.slow
def test_moduli_and_mass_that_go_together_are_a_thickness():
    """A weighed plate 4 % thinner than stated has 4 % less mass and moduli 11 to 12 % too low."""

    def weighed(name, e1, thin=1.0, stated=3.0):
        described = plate(name, e1, thickness_mm=stated * thin)
        mass = 0.3 * 0.26 * 1e-3 * stated * thin * 2700.0 * 1e3
        described["plate"] |= {"thickness_mm": stated, "mass_g": mass}
        del described["plate"]["density_kg_m3"]
        return with_noise(described, np.random.default_rng(int(e1)))

    plates = [weighed(f"b{i}", 69.0 + i) for i in range(4)]
    result = cb.batch(*plates, weighed("thin", 70.0, 0.96, 3.06), limits=["E1_GPa >= 66"])
    near = replace(result, limits=(read_limit("E1_GPa >= 62"),))
    for judged, verdict in ((result, "fail"), (near, "too close to call")):
        assert f"1 {verdict} (thin: thinner by about 4 %; gauge it)" in judged.report().summary.headline


def test_a_repeat_is_no_advice_where_the_thickness_decides():
    close = plate("close", e1=70.2)
    for sd, noise, step in (
        (0.06, 0.002, "gauge close more accurately: its thickness dominates"),
        (0.001, 0.01, "repeat the test"),
    ):
        close["plate"]["sd"] = {"thickness_mm": sd, "density_kg_m3": 0.1}
        close["measurement"]["relative_std"] = noise
        assert cb.batch(close, limits=["E1_GPa >= 70"]).report().summary.next_step.startswith(step)


@pytest.mark.slow
def test_copies_are_named_and_a_plate_that_misfits_is_diagnosed_unasked_and_kept(tmp_path):
    good, odd = plate("good"), plate("odd")
    odd["measurement"]["frequencies_hz"][3] *= 1.01
    first, again = (cb.batch(good, {**good, "name": "copy"}, odd, store=tmp_path) for _ in range(2))
    states = [(row.misfit > 1.0, row.diagnosis is not None) for row in first.rows]
    assert states == [(False, False), (False, False), (True, True)]
    told = {notice.code: notice.facts["plates"] for notice in first.notices}
    assert told["equal_lists"] == ("good", "copy")
    assert [name for name, _ in told["undescribed_plates"]] == ["odd"]
    assert without_store(again) == without_store(first)


def test_an_unforeseen_error_is_a_row_and_files_that_contradict_themselves_are_named(monkeypatch, tmp_path):
    wrong = plate("wrong")
    wrong["plate"]["mass_g"] = 10.0
    result = cb.batch(wrong)
    assert result.notices[1] == Notice("disagreeing_plates", "slip", {"plates": ("wrong",)})
    (row,) = result.rows
    assert "mass over density" in row.message
    assert "likely slip" not in row.message

    def fails(*arguments, **options):
        raise ZeroDivisionError("by chance")

    monkeypatch.setattr(module, "computed_row", fails)
    result = cb.batch("A1")
    assert result.rows[0].message == "ZeroDivisionError: by chance"
    assert (result.status, result.reached_goal) == ("failed", False)
    assert result.report().summary.headline.startswith("0 of 1 ")
    with pytest.raises(ValueError, match="a folder without plate files"):
        cb.batch(tmp_path)
    for name in ("b.toml", "a.toml"):
        (tmp_path / name).write_text("")
    found = cb.batch(str(tmp_path / "?.toml"))
    assert [row.file[-6:] for row in found.rows] == ["a.toml", "b.toml"]
    with pytest.raises(ValueError, match="no file matches"):
        cb.batch("A1", str(tmp_path / "*.nothing"))


@pytest.mark.slow
@pytest.mark.weekly
def test_a_batch_with_diagnosis_has_the_claims_of_diagnose():
    quiet, swapped = with_noise(plate("quiet"), np.random.default_rng(1)), plate("misread")
    swapped["measurement"]["frequencies_hz"][3] *= 1.06
    swapped["measurement"]["frequencies_hz"].sort()
    result = cb.batch(quiet, swapped, diagnosis=True)
    for row, described in zip(result.rows, (quiet, swapped), strict=True):
        alone, found = cb.diagnose(described, next_test="never"), row.diagnosis
        assert (found.claim, found.causes) == (alone.claim, alone.causes)
        assert found.probability == pytest.approx(alone.probability, abs=1e-9)


def likelihood(at, information, gradient=None):
    at, information = np.atleast_1d(at), np.atleast_2d(information)
    g = np.zeros(len(at)) if gradient is None else np.atleast_1d(gradient)
    names = ("E1", "E2", "nu12", "G12")[: len(at)]
    return plate_row.LocalLikelihood(names, tuple(at), tuple(g), tuple(map(tuple, information)))


def row(number, local):
    constants = tuple(
        plate_row.RowConstant(name, v, 1.0, 0.0, 1.0, Verdict.DATA, MarginalPosterior(v, 1.0, 0.0, 200.0))
        for name, v in zip(local.names, local.at, strict=True)
    )
    return plate_row.PlateRow(f"p{number}", f"p{number}", "done", "", "carbon", constants, local)


def test_the_likelihood_is_the_gaussian_of_both_scatters_together():
    """N(at; mu, T + F^-1) over the integral of exp(-1/2 d F d), and the same with a slope at the optimum."""
    rng = np.random.default_rng(2)
    a = rng.standard_normal((3, 3))
    f = a @ a.T + np.eye(3)
    at, g = np.array([5.0, 2.0, 1.0]), np.array([0.3, -0.2, 0.1])
    density = batch_posterior([likelihood(at, f, g)], [(0.0, 50.0)] * 3)
    moved = np.linalg.solve(f, g)
    integral = 1.5 * np.log(2.0 * np.pi) - 0.5 * np.linalg.slogdet(f)[1] + 0.5 * g @ moved
    for _ in range(5):
        mean, scatter = at * rng.uniform(0.8, 1.2, 3), rng.uniform(1e-4, 0.4, 3)
        x = np.concatenate((mean / density.scale, scatter))
        covariance = np.diag((scatter * density.scale) ** 2) + np.linalg.inv(f)
        expected = multivariate_normal(mean, covariance).logpdf(at + moved) + integral
        assert density.log_likelihood(x[None])[0] == pytest.approx(expected, rel=1e-9)


def test_the_chains_have_the_posterior_that_a_grid_gives():
    rng, own = np.random.default_rng(5), 1.5
    values = 100.0 + 3.0 * rng.standard_normal(12) + own * rng.standard_normal(12)
    each = [likelihood(v, own**-2.0) for v in values]
    population = population_of([row(i, local) for i, local in enumerate(each)], seed=0)
    (found,) = population.constants
    density = batch_posterior(each, [(0.0, 200.0)])
    mean, scatter = np.linspace(0.93, 1.07, 241), np.linspace(1e-4, 0.16, 321)
    p = on_grid(density, mean, scatter)
    for values_of, marginal, (m, sd, *quantiles) in (
        (mean * density.scale[0], p.sum(axis=1), found.mean),
        (scatter, p.sum(axis=0), found.scatter),
    ):
        expected, spread = moments(marginal, values_of)
        assert m == pytest.approx(expected, abs=0.12 * spread)  # mean to 3 % of the spread, quantiles to 6 %
        assert sd == pytest.approx(spread, rel=0.12)
        exact = np.interp((0.025, 0.975), np.cumsum(marginal), values_of)
        assert quantiles == pytest.approx(exact, abs=0.25 * spread)
    assert population.status == "converged"
    wide = np.hypot(found.mean[1], found.scatter[0] * 100.0)
    assert found.next_plate[1] == pytest.approx(wide, rel=0.15)


def test_plates_that_do_not_scatter_have_a_small_one_and_open_constants_the_prior():
    rng = np.random.default_rng(3)
    information = np.diag([1.0, 0.0])  # E1 to 1 in 100, nothing about the other
    rows = [row(i, likelihood([100.0 + rng.standard_normal(), 50.0], information)) for i in range(25)]
    e1, e2 = population_of(rows, seed=0).constants
    assert e1.scatter[3] < 0.015
    assert e2.scatter[0] == pytest.approx(0.049, abs=0.008)  # half a Student-t of 5 %, nu = 4: mean 5 %
    assert e2.mean[1] == pytest.approx(200.0 / np.sqrt(12.0), rel=0.1)


@pytest.mark.slow
def test_lists_of_simulated_plates_give_the_constants_of_their_material():
    rng = np.random.default_rng(1)
    moduli = 70.0 * (1.0 + 0.03 * rng.standard_normal(8))
    plates = [with_noise(plate(f"p{i}", e1=e), rng) for i, e in enumerate(moduli)]
    result, again = (cb.batch(*plates, hierarchical=True) for _ in range(2))
    e1 = result.population.constants[0]
    assert abs(e1.mean[0] / 1e9 - moduli.mean()) < 3.0 * e1.mean[1] / 1e9
    assert e1.scatter[2] < 0.03 < e1.scatter[3]
    np.testing.assert_array_equal(again.population.draws, result.population.draws)
    document = result.to_dict()["population"]["constants"]["E1_GPa"]
    assert document["mean"]["mean"] == pytest.approx(e1.mean[0] / 1e9)
    assert document["scatter_percent"]["mean"] == pytest.approx(100.0 * e1.scatter[0])
    assert "The material" in result.summary()


def test_a_batch_that_has_no_scatter_says_why_and_keeps_its_rows(run):
    status, out, err = run("batch", "A1", "A1", "--hierarchical", "--quiet", "--executor", "serial")
    assert status == 1
    assert "A1" in out
    assert "2 plates have an answer, a scatter needs 3 or more" in err
    three = [row(i, likelihood(70.0, 1.0)) for i in range(3)]
    for other, said in (
        (replace(three[0], material="glass"), "several materials: carbon, glass"),
        (row(4, likelihood([70.0, 0.3], np.eye(2))), "different unknown constants"),
    ):
        with pytest.raises(ValueError, match=said):
            population_of([*three, other], seed=0)


def test_a_stiffer_plate_is_larger_by_its_ratio():
    rng = np.random.default_rng(3)
    a, b = (exact(with_noise(plate(name, e1), rng)) for name, e1 in (("a", 68.0), ("b", 71.4)))
    found = cb.compare(a, b)
    e1, nu12 = found.differences["E1"], found.differences["nu12"]
    assert abs(e1.percent - 5.0) < 3.0 * e1.sd_percent < 10.0
    assert e1.probability_larger > 0.975
    assert (e1.differs, nu12.differs) == (True, False)
    assert "b differs from a in E1 by +" in found.report().summary.headline
    # E1 scales with f^2 / h^2 for a stated density, with f^2 / h^3 for a stated mass
    next_step = found.report().summary.next_step
    assert "1 % error in thickness changes all moduli by 2 %, by 3 % if weighed" in next_step
    keys = {"percent": e1.percent, "sd_percent": e1.sd_percent, "probability_larger": e1.probability_larger}
    assert found.to_dict()["differences"]["E1_GPa"] == keys | {"determined": True}


@pytest.mark.slow
def test_a_plate_does_not_differ_from_itself_and_the_order_turns_the_sign():
    rng = np.random.default_rng(4)
    a, b = with_noise(plate("a"), rng), with_noise(plate("b", 72.0), rng)
    same = cb.compare(a, a).differences["E1"]
    assert abs(same.percent) < 0.1 * same.sd_percent
    assert same.probability_larger == pytest.approx(0.5, abs=0.02)
    there, back = (cb.compare(*pair).differences["E1"] for pair in ((a, b), (b, a)))
    assert there.probability_larger + back.probability_larger == pytest.approx(1.0, abs=0.01)
    assert (1.0 + 0.01 * there.percent) * (1.0 + 0.01 * back.percent) == pytest.approx(1.0, abs=2e-3)


def test_a_prior_that_may_be_the_posterior_of_the_other_plate_is_said(tmp_path):
    first = plate("first")
    second = with_noise(plate("second"), np.random.default_rng(6))
    assert not cb.compare(first, second).warnings
    draws = {"E1_GPa": np.linspace(66.0, 74.0, 200)}
    second["material"]["posterior"] = str(write_posterior(tmp_path / "posterior.nc", draws))
    (said,) = cb.compare(first, second).warnings
    assert said.startswith("The prior of second is the posterior of an earlier plate.")


def test_the_command_prints_the_keys_of_the_contract(run):
    status, text, _ = run("compare", "A1", "A2", "--json", "--quiet")
    assert status == 0
    assert set(json.loads(text)["differences"]) == {"E1_GPa", "nu12"}


@pytest.mark.slow
def test_plates_that_the_model_does_not_describe_are_not_compared_and_a_slip_is_named():
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
