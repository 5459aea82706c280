"""A table of modes is read as instruments and laboratories write it, and errors state their place."""

import io
import zipfile
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import t

import cpam_bayes as cb
from cpam_bayes.answer import as_written
from cpam_bayes.errors import PlateFileError
from cpam_bayes.plate.modes_of_hits import small_sample_factor
from cpam_bayes.render.plate import measured_facts
from cpam_bayes.render.report import plate_keys
from tests.layouts import MODES, TABLE, TAPPED, THREE, WIDE, sheet, wide
from tests.plate_file import OF_TABLE

EQUAL_HITS = "mode,hit,hz\n1,1,101.5\n1,2,101.5\n1,3,101.5\n2,1,305.2\n2,2,305.2\n2,3,305.2\n"
HITS = "mode,hit,hz\n1,1,100.2\n1,2,100.6\n1,3,100.1\n2,1,310.0\n2,2,311.0\n2,3,312.0\n3,1,400.0\n"
BESIDE = 'table = "modes.csv"\n'
SIDES = "mode;left [Hz];right [Hz]\n1;101,5;9\n2;305,25;9\n3;333;9\n"


def test_a_stated_repeatability_is_the_least_that_hits_give(measured) -> None:
    identical = measured(EQUAL_HITS, "relative_std = 0.002\n")
    assert identical.frequency_sd == pytest.approx(0.002 * identical.frequencies)
    assert identical.remarks == ()
    scattered = measured(EQUAL_HITS.replace("1,2,101.5", "1,2,111.5"), "relative_std = 0.002\n")
    assert scattered.frequency_sd[0] > 0.05 * scattered.frequencies[0]
    assert measured("mode,hz,sd\n1,100,0.3\n2,300,0.5\n").frequency_sd.tolist() == [0.3, 0.5]


def test_identical_hits_with_nothing_stated_are_told_of(read) -> None:
    plate = read(EQUAL_HITS)
    assert plate.measurement.frequency_sd == pytest.approx(0.1 / np.sqrt(12.0))
    (remark,) = plate.measurement.remarks
    assert remark.startswith("modes.csv: the hits of each mode are equal to the last digit")
    assert as_written([remark])[0] in cb.forward(plate).notices
    assert read(EQUAL_HITS.replace("1,2,101.5", "1,2,101.6")).measurement.remarks == ()


@pytest.mark.parametrize("wrong", ["3.052", "30520", "250"])
def test_a_hit_far_from_the_others_of_its_mode_is_named_before_it_is_averaged(refused, wrong: str) -> None:
    (problem,) = refused(EQUAL_HITS.replace("2,2,305.2", f"2,2,{wrong}"))
    said = f"modes.csv line 6, column hz: mode 2, hit 2: received {float(wrong):g} Hz beside 305.2, 305.2 Hz"
    assert problem.startswith(said)
    assert "weight of 0" in problem


def test_damping_that_no_composite_has_is_said_to_be_read_as_a_ratio(measured) -> None:
    (remark,) = measured("mode,hz,damping\n1,101.5,0.4\n2,305.2,0.3\n").remarks
    assert "damping up to 0.4 is read as a ratio, 40 % of critical damping" in remark
    assert "the head is damping [%]" in remark
    (remark,) = measured("mode,hz,damping [%]\n1,101.5,40\n2,305.2,30\n").remarks
    assert remark.endswith("damping up to 40 % of critical damping, where composite plates have 0.05 to 3 %")
    assert measured("mode,hz,damping [%]\n1,101.5,0.4\n2,305.2,0.3\n").remarks == ()


def test_labels_name_modes_and_fix_them_and_a_table_needs_no_more_than_frequencies(measured) -> None:
    heads = ["(1,1)", "(2,0)", "(0,2)"]
    assert measured(wide(";", heads, first="hit", mark=",")).labels == tuple(heads)
    bare = measured("hz\n311\n102,5\n")
    assert (bare.frequencies.tolist(), bare.damping, bare.loss_factors) == ([102.5, 311.0], None, None)
    found = measured('label;hit;hz\n"(1,1)";1;102\n"(2,0)";1;311\n"(1,1)";2;104\n"(2,0)";2;311,6\n')
    assert found.labels == ("(1,1)", "(2,0)")
    np.testing.assert_allclose(found.frequencies, [103.0, 311.3], rtol=1e-12)


def test_hits_below_and_beside_each_other_become_their_mean_and_the_scatter_of_one(measured) -> None:
    found = measured(HITS)
    first, second = np.array([100.2, 100.6, 100.1]), np.array([310.0, 311.0, 312.0])
    np.testing.assert_allclose(found.frequencies, [first.mean(), 311.0, 400.0], rtol=1e-12)
    scatter = [hits.std(ddof=1) * t.ppf(0.975, 2) / 1.959963984540054 for hits in (first, second)]
    np.testing.assert_allclose(found.frequency_sd[:2], scatter, rtol=1e-12)
    # a single hit: the pooled relative scatter of the others, with 4 degrees of freedom
    pooled = np.sqrt(np.mean([first.var(ddof=1) / first.mean() ** 2, second.var(ddof=1) / 311.0**2]))
    alone = 400.0 * pooled * t.ppf(0.975, 4) / 1.959963984540054
    assert found.frequency_sd[2] == pytest.approx(alone, rel=1e-12)
    # the same hits in rows and in columns
    rows = (f"{m},{i},{f}" for i, hit in enumerate(TAPPED, 1) for m, f in enumerate(hit, 1))
    meant = measured("\n".join(["mode,hit,hz", *rows, ""])).frequency_sd
    beside = measured(wide(";", THREE, first="hit", mark=",")).frequency_sd
    np.testing.assert_allclose(beside, meant, rtol=1e-12)


@pytest.mark.parametrize("n", [2, 3, 5, 10])
def test_the_interval_of_few_hits_holds_a_further_one_as_often_as_it_says(n: int) -> None:
    rng = np.random.default_rng(n)
    hits, further = rng.standard_normal((20_000, n)), rng.standard_normal(20_000)
    half = 1.96 * hits.std(axis=1, ddof=1) * small_sample_factor(n - 1.0)
    inside = np.abs(further - hits.mean(axis=1)) < half * np.sqrt(1.0 + 1.0 / n)  # the mean varies too
    assert inside.mean() == pytest.approx(0.95, abs=0.0062)  # four standard errors


def test_a_weight_of_0_leaves_a_hit_out_and_others_weigh(measured) -> None:
    found = measured("mode,hz,weight,damping\n1,100,1,0.01\n1,180,0,0.2\n1,103,2,0.04\n2,300,1,\n2,301,1,\n")
    assert found.frequencies[0] == pytest.approx(102.0, rel=1e-12)
    assert found.damping[0] == pytest.approx(0.03, rel=1e-12)
    weighed = EQUAL_HITS.replace("hz\n", "hz,weight\n").replace("2,2,305.2\n", "2,2,3.052,0\n")
    assert measured(weighed).frequencies == pytest.approx([101.5, 305.2])


@pytest.mark.parametrize(
    ("content", "gap", "left"),
    [
        ("mode,hz,weight\n1,100,1\n2,200,0\n3,300,1\n", "line 3, column hz: mode 2 is left out", [100, 300]),
        ("mode,hz,weight\n1,100,1\n2,400,0\n3,300,1\n", None, [100, 300]),
        ("mode,hz\n7,100\n8,200\n10,300\n", "column mode: the numbers lack 9", [100, 200, 300]),
    ],
    ids=["left out", "the last one left out", "a number is lacking"],
)
def test_a_mode_left_out_makes_a_gap_that_must_be_said(measured, refused, content, gap, left) -> None:
    if gap:
        (problem,) = refused(content)
        assert problem.startswith(f"modes.csv {gap}, accepted: complete = false")
    found = measured(content, "complete = false\n" if gap else "")
    assert found.frequencies.tolist() == left
    assert ("left out: 2" in found.origin) == ("weight" in content)


def test_everything_that_is_wrong_with_a_table_comes_at_once(refused) -> None:
    problems = refused("mode,hz,damping\n1,abc,0.1\n2,200,7\n3,300,0.1\n4,-1,y\n")
    places = ["line 2, column hz", "line 3, column damping", "line 5, column hz", "line 5, column damping"]
    assert [problem.partition(": ")[0] for problem in problems] == [f"modes.csv {place}" for place in places]


@pytest.mark.parametrize(
    ("tables", "said"),
    [
        ('table = "none.csv"\n', "measurement.table: no such file"),
        ('table = "."\n', "a directory, accepted: a table of modes"),
        ('table = "a\\u0000b"\n', "measurement.table: .*cannot be"),
        (f"{BESIDE}frequencies_hz = [100]\n", "one of frequencies_hz, table, recordings, peaks and shapes"),
        (f"{BESIDE}frequency_sd_hz = [1, 1, 1]\n", "a column sd in the table"),
        (f'{BESIDE}labels = ["", "", ""]\n', "a column label in the table"),
        ("resolution_hz = 1\n", "received none, accepted: one of frequencies_hz, table, recordings, peaks"),
        ('frequencies_hz = [100]\n[measurement.columns]\nhz = "b"\n', "beside no table"),
    ],
)
def test_frequencies_come_from_one_place(read, tmp_path: Path, tables: str, said: str) -> None:
    read(TABLE)
    path = tmp_path / "bar.toml"
    path.write_text(f"{OF_TABLE}{tables}", encoding="utf-8")
    with pytest.raises(PlateFileError, match=said) as caught:
        cb.read_plate(path)
    assert len(caught.value.problems) == 1


def test_damping_is_shown_and_in_the_document(read) -> None:
    specimen = read("mode,hit,hz,damping [%],comment\n1,1,100,0.4,x\n1,2,101,0.5,y\n2,1,300,,z\n")
    rows = dict(row[:2] for row in measured_facts(specimen).rows)
    assert rows["damping ratio"] == "0.450, - %"
    assert rows["loss factor"] == "0.00900, -"
    assert rows["read from"] == "modes.csv: means of 1 to 2 hits a mode; columns not used: comment"
    assert "of a single hit, from the table" in rows["repeatability"]
    ratios = [row["damping_ratio"] for row in plate_keys("forward", 0, specimen)["damping"]]
    np.testing.assert_allclose(ratios, [0.0045, np.nan], rtol=1e-12)
    assert "damping" not in plate_keys("forward", 0, cb.read_plate("A1"))


def test_the_example_of_a_table_is_the_panel_of_the_other_example(monkeypatch) -> None:
    monkeypatch.chdir(Path(__file__).parents[2])  # a table is beside its plate file, wherever we are
    found, listed = (cb.read_plate(f"examples/{name}.toml").measurement for name in ("panel_hits", "panel"))
    # means of five hits that scatter by 0.2 %, one of them left out
    np.testing.assert_allclose(found.frequencies, listed.frequencies, rtol=2e-3)
    assert np.all(found.frequency_sd < 0.006 * found.frequencies)
    assert found.origin == "panel_hits.csv: means of 4 to 5 hits a mode"


def packed(size: int) -> bytes:
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("xl/sharedStrings.xml", bytes(size))
    return content.getvalue()


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ("mode,hz\n1,100\n2,abc\n", 'line 3, column hz: not a number, received "abc"'),
        ("mode;hz\n1;100\n\n2;-5\n", "line 4, column hz: out of range, received -5"),
        ("mode;hz\n1;12.34,5\n", 'line 2, column hz: not a number, received "12.34,5"'),
        ("mode;hz\n1;100.5\n2;200,5\n", "line 3, column hz: another decimal mark than in line 2"),
        ("mode,hz\n1,100,5\n", "line 2: 3 cells for 2 columns, accepted: one for each head; decimal commas"),
        ("mode,hz,damping\n1,100,0.4\n2,200,1.2\n", "line 3, column damping: out of range, received 1.2"),
        ("mode,hz,sd\n1,100,0.5\n2,200,\n", "line 3, column sd: missing"),
        ("mode,hz,weight\n1,100,0\n", "no frequency, or no weight above 0"),
        ("mode,hz,dampng\n1,100,1\n", "line 1, column dampng: unknown head, the nearest is damping"),
        ("mode,hz,frequency\n1,100,100\n", "line 1, column frequency: a second column hz"),
        ("mode,Frequency [rpm]\n1,100\n", "line 1, column Frequency [rpm]: unknown unit rpm"),
        ("hit,hz\n1,100\n", "line 1, column hit: hits of no mode"),
        ("mode,hit,hz\n1,1,100\n1,1,101\n", "line 3, column hit: hit 1 of mode 1 a second time"),
        ("mode,hit,hz\n,1,100\n", "line 2, column mode: missing"),
        ("mode,label,hz\n1,a,100\n1,b,101\n", "line 3, column label: mode 1 has the labels a and b"),
        ("mode,label,hz\n1,\x1b[31m,100\n", "line 2, column label: not a text that can be shown"),
        ("mode,hz\n", "line 1: no rows below the heads"),
        (b"\x00\x01\x02" * 50, "no column of frequencies"),
        ("hz\n" + "".join(f"{100 + i}\n" for i in range(101)), "too many modes, received 101"),
        ("hit,1,2\n1,101,5,305,2\n", "decimal commas need another separator"),
        (wide(";", THREE, first="hit").replace("305.2", "13.05,2"), "not a number"),
        ("hit;f1 [Hz];f2 [kHz]\n1;101,5;0,305\n", "units hz and khz beside each other"),
        ("Mode;f [kHz]\n;Hz\n1;101,5\n2;305\n", 'line 2, column f [kHz]: not a number, received "Hz"'),
        ("hit;1;2\n1;101;305\n2;305;306\n", "hits of one mode, which agree to 20 %"),
        (b"\xd0\xcf\x11\xe0" + bytes(2000), "an .xls file or one with a password"),
        (sheet(WIDE)[:900], "no workbook that can be read"),
        (packed(60_000_000), "too large, 60000000 bytes unpacked"),
        ("hz\n" + "1" * 260_000, "too large"),
        ('hz\n"' + "1" * 200_000, None),
    ],
    ids=lambda value: "bytes" if isinstance(value, bytes) else None,  # a workbook contains the time
)
def test_what_is_wrong_has_its_line_and_column(refused, content: str | bytes, said: str | None) -> None:
    problems = refused(content)
    assert len(problems) == 1
    assert "\x1b" not in problems[0]
    assert said is None or said in problems[0]
    assert len(problems[0]) < 400


@pytest.mark.parametrize(
    ("content", "choices", "right"),
    [
        (SIDES, ("left [Hz]", "right [Hz]"), "left [Hz]"),
        ("mode;Frequency;f\n1;101,5;9\n2;305,25;9\n3;333;9\n", ("Frequency", "f"), "Frequency"),
        ("mode;Width [Hz];peak\n1;9;101,5\n2;8;305,25\n3;9;333\n", ("Width [Hz]", "peak"), "peak"),
        ("mode;at [Hz];force\n1;101,5;999\n2;305,25;999\n3;333;999\n", ("at [Hz]", "force"), "at [Hz]"),
        ("who;a;b\nx;1;101,5\ny;2;305,25\nz;3;333\n", ("a", "b"), "b"),
    ],
)
def test_columns_that_may_be_the_frequencies_are_told_apart_by_name(measured, read, content, choices, right):
    with pytest.raises(PlateFileError, match=r"measurement\.columns") as caught:
        read(content)
    assert caught.value.choices == choices
    found = measured(content, f'[measurement.columns]\nhz = "{right}"\n')
    np.testing.assert_allclose(found.frequencies, MODES, rtol=1e-9)


@pytest.mark.parametrize(
    ("content", "columns"),
    [
        ("a;b\n1;101,5\n2;305,25\n3;333\n", 'mode = "a"\nhz = "b"'),
        (wide(";", ["erste", "zweite", "dritte"], first="wer"), 'hz = ["erste", "zweite", "dritte"]'),
    ],
)
def test_heads_are_named_in_the_plate_file(measured, read, content: str, columns: str) -> None:
    with pytest.raises(PlateFileError, match="column sigma: no such head, accepted: a, b"):
        read("a;b\n1;101,5\n", '[measurement.columns]\nhz = "b"\nsd = "sigma"\n')
    with pytest.raises(PlateFileError, match=r"no column of frequencies.*columns\]: hz ="):
        read("a;b\n1;101,5\n", '[measurement.columns]\nmode = "a"\n')
    found = measured(content, f"[measurement.columns]\n{columns}\n")
    np.testing.assert_allclose(found.frequencies, MODES, rtol=1e-9)
