"""The question `prove`: reading, seal and findings."""

import hashlib
from dataclasses import replace

import numpy as np
import pytest

import cpam_bayes as cb
from cpam_bayes.errors import PlateFileError
from cpam_bayes.questions.prove.lists import given_twice
from cpam_bayes.render.notices import sentence_of
from cpam_bayes.render.terminal import plain_text
from tests.plate_file import PLATE

N = 8
COIN = {"mass_g": 20.0, "x_mm": 60.0, "y_mm": 50.0}
SEAL = "[[coin]]\nmass_g = 20\nx_mm = 60\ny_mm = 50\n\n[[coin]]\nmass_g = 0\n"
DIGEST = hashlib.sha256(SEAL.encode()).hexdigest()


@pytest.fixture(scope="module")
def lists(tmp_path_factory):
    """The plate file, a table with the coin on it, a TOML file without, and the seal."""
    folder, rng = tmp_path_factory.mktemp("coin"), np.random.default_rng(0)

    def written(name, text):
        (folder / name).write_text(text, encoding="utf-8")
        return str(folder / name)

    def noisy(f):
        return [float(v) for v in np.round(f * (1 + 0.001 * rng.standard_normal(N)), 2)]

    plate = PLATE.replace("density_kg_m3 = 2700.0", "mass_g = 680.4")
    bare = cb.forward(written("bare.toml", plate), N).frequencies
    loaded = plate + "\n[[sensor]]\n" + "\n".join(f"{k} = {v}" for k, v in COIN.items())
    with_coin = cb.forward(written("loaded.toml", loaded), N).frequencies
    written("seal.toml", SEAL)
    measured = f"\n[measurement]\nfrequencies_hz = {noisy(bare)}\nrelative_std = 0.001\n"
    rows = "\n".join(f"{i},{f}" for i, f in enumerate(noisy(with_coin), 1))
    files = {"plate.toml": plate + measured, "coin.csv": f"mode,hz\n{rows}\n"}
    files["none.toml"] = f"frequencies_hz = {noisy(bare)}\n"
    return folder, *(written(name, text) for name, text in files.items())


@pytest.fixture(scope="module")
def result(lists):
    folder, plate, coin, none = lists
    return cb.prove(plate, coin, none, sealed=folder / "seal.toml", seed=1)


@pytest.mark.slow
def test_a_table_and_a_list_are_answered_and_the_seal_is_compared(result):
    document = result.to_dict()
    coin, none = document["coins"]
    assert (coin["finding"], none["finding"], none["found_g"]) == ("mass added", "nothing added", None)
    assert coin["q025_g"] < 20.0 < coin["q975_g"]
    assert coin["distance_mm"] < 15.0
    assert coin["stated_g"] == pytest.approx(20.0)
    assert coin["shifts_inside"] >= 6  # 95 % of 8 shifts
    assert document["coverage"] == {"mass": 1.0, "shifts": pytest.approx(1.0, abs=0.2)}
    assert 0.0 < document["detection_limit_g"] < 20.0


def test_the_certificate_says_what_was_found_for_what_was_sealed_and_the_shifts(result):
    document = result.to_dict()  # the second list is predicted from the first and the seal
    rows = document["shifts"]
    assert len(rows) == 2 * N
    for row in rows:
        beyond = abs(np.log(row["measured_hz"] / row["predicted_hz"])) * row["predicted_hz"] / row["sd_hz"]
        assert row["inside"] == (beyond <= 1.96)
    # a list without a mass is predicted to equal the first
    assert [row["predicted_hz"] for row in rows[N:]] == pytest.approx([row["first_hz"] for row in rows[N:]])
    low, high = document["repeatability"]
    assert low < 0.001 < high < 3.0 * low
    assert 0.0 < document["shift_error"] < 0.5
    certificate = result.report().sections[0].tables[0]
    shown = plain_text(certificate)
    assert "repeatability, from the shifts" in shown
    assert result.hash == document["hash"] == DIGEST
    assert DIGEST in shown
    coin, none = (coin.found for coin in result.coins)  # beside the sealed value, with its mirror images
    of_coin, of_none = (row[1] for row in certificate.rows if row[0] in ("coin.csv", "none.toml"))
    assert of_coin.startswith("In this laboratory, on this plate, ")
    images = [f"({1e3 * x:.0f}, {1e3 * y:.0f})" for x, y in coin.images]
    assert len(images) == 3
    assert all(part in of_coin for part in ("was found, 20.0 g sealed, ", "Sealed at (60, 50) mm.", *images))
    assert "g or more was found, no mass sealed; " in of_none
    assert "(0, 0)" not in of_none
    assert not none.images or "mirror" not in of_none
    single = replace(result, coins=result.coins[:1])
    (said,) = (line for line in single.report().summary.lines if "mirror images" in line)
    assert images[0] in said


@pytest.mark.parametrize("quiet", [(), ("--quiet",)])  # without progress, but with the promise
def test_the_hash_is_shown_before_the_work(run, lists, monkeypatch, quiet):
    def begun(*args, **options):
        raise ValueError("the work has begun")

    monkeypatch.setattr("cpam_bayes.questions.prove.identify", begun)
    folder, *files = lists
    _, out, err = run("prove", *files, "--sealed", folder / "seal.toml", *quiet)
    assert (out, err) == ("", f"SHA-256 of the seal: {DIGEST}\nerror: the work has begun\n")


COIN_OF = "[[coin]]\nmass_g = {}\nx_mm = {}\ny_mm = 3\n"
NONE = "[[coin]]\nmass_g = 0\n"


@pytest.mark.parametrize(
    ("seal", "said"),
    [
        (COIN_OF.format(1, 2), "1 tables"),
        ("[[coin]]\nmass_g = 1\nx_mm = 2\n" + NONE, "mass_g, x_mm and y_mm"),
        (COIN_OF.format(7.25, 999) + NONE, "on the plate"),
        (COIN_OF.format(110, 9) + NONE, "0 to 100 g, 15 %"),
        (COIN_OF.format("5,1", 9) + NONE, r"seal\.toml:2: file: not valid TOML$"),
        (None, "no such file, accepted: a sealed file"),
    ],
)
def test_a_seal_that_fits_no_list_is_refused_before_the_work_and_not_given_away(lists, tmp_path, seal, said):
    _, plate, coin, none = lists
    if seal is not None:
        (tmp_path / "seal.toml").write_text(seal, encoding="utf-8")
    with pytest.raises(PlateFileError, match=said) as refusal:
        cb.prove(plate, coin, none, sealed=tmp_path / "seal.toml")
    assert not {"7.25", "999", "5,1"} & set(str(refusal.value).split())


@pytest.mark.slow
def test_lists_that_cannot_be_compared_are_refused(lists, tmp_path):
    _, plate, coin, _ = lists
    seal, specimen = tmp_path / "seal.toml", cb.read_plate(plate)
    seal.write_text(COIN_OF.format(7.25, 60), encoding="utf-8")
    # a plate model that is far off says nothing about a mass
    clamped = replace(specimen, plate=replace(specimen.plate, edges="CFFF"))
    for own, other, said in (
        (plate, str(seal), "a sealed file, accepted: a list; give it as --sealed"),
        (plate, [100.0, 200.0], "the same modes in both"),
        (clamped, coin, "% off the plate model, whose mode shapes"),
    ):
        with pytest.raises(PlateFileError, match=said) as error:
            cb.prove(own, other)
        assert "7.25" not in str(error.value)


def test_a_list_that_is_given_twice_is_told(lists):
    first = cb.read_plate(lists[1]).measurement
    other = replace(first, frequencies=first.frequencies + 0.01)
    found = list(given_twice(first, [("a.csv", other), ("b.csv", first), ("c.csv", other)]))
    told = [(n.facts["name"], n.facts["before"]) for n in found]
    assert told == [("b.csv", "the first list"), ("c.csv", "a.csv")]
    (same,) = given_twice(first, [("a.csv", other), ("a.csv", other)])
    assert same.facts == {"name": "a.csv", "before": "a.csv"}
    assert sentence_of(found[0]).startswith("The frequencies of b.csv are those of the first list")
