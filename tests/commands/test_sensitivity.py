"""`cpam-bayes sensitivity` as a user and a script see it."""

import json
import re

import numpy as np
import pytest

from cpam_bayes.inference.chains.ensemble import EnsembleSettings
from cpam_bayes.inference.swarm.settings import SwarmSettings
from cpam_bayes.repetition import sensitivity
from tests.plate_file import MEASURED, PLATE

FEW = ("--groups", "3", "--executor", "serial", "--quiet")


@pytest.fixture(scope="module")
def cache(tmp_path_factory):
    return tmp_path_factory.mktemp("cache")


@pytest.fixture(autouse=True)
def own_cache(cache, monkeypatch):
    monkeypatch.setenv("CPAM_BAYES_CACHE", str(cache))


@pytest.fixture
def plate_file(tmp_path):
    def write(text=PLATE):
        path = tmp_path / "plate.toml"
        path.write_text(text, encoding="utf-8")
        return str(path)

    return write


@pytest.fixture
def short(monkeypatch):
    """Swarms and chains that end long before they converge."""
    full = sensitivity.noise_study

    def hurried(*args, **kwargs):
        chains = EnsembleSettings(walkers=12, round_steps=40, most_steps=40)
        swarm = SwarmSettings(particles=10, iterations=30)
        return full(*args, **{**kwargs, "chains": chains, "swarm_settings": swarm})

    monkeypatch.setattr(sensitivity, "noise_study", hurried)


@pytest.mark.slow
def test_a_plate_without_a_measurement_gets_the_answer_of_the_contract(run, plate_file, tmp_path):
    out_dir = tmp_path / "out"
    argv = ("sensitivity", plate_file(), "--levels", "1", "--modes", "6", "--json", "--out", str(out_dir))
    status, out, err = run(*argv, *FEW)
    document = json.loads(out)
    assert (status, err) == (0, "")
    assert len(document["frequencies_hz"]) == 6
    (level,) = document["levels"]
    assert (level["level_percent"], level["reading"]) == (1.0, "relative")
    assert set(level["constants"]) == {"E1_GPa", "nu12"}
    for reading in ("relative", "rms"):
        for name, truth in (("E1_GPa", 69.0), ("nu12", 0.33)):
            own = level["readings"][reading]["constants"][name]
            assert own["paper_percent_error"] is None
            # three inversions at 1 %: within a few standard errors of a mean of three
            spread = max(own["repetition_sd"], own["posterior_sd"]) / np.sqrt(3)
            assert abs(own["repetition_mean"] - truth) < 5 * spread
            assert abs(own["posterior_mean"] - truth) < own["posterior_sd"]
            assert own["posterior_sd"] == pytest.approx(own["linearised_posterior_sd"], rel=0.25)
    assert json.loads((out_dir / "sensitivity.json").read_text()) == document
    assert (out_dir / "figures" / "sensitivity.png").stat().st_size > 0


def test_chains_that_did_not_converge_end_with_status_1_and_say_so(run, plate_file, short):
    status, out, err = run(
        "sensitivity", plate_file(), "--levels", "5", "--reading", "rms", "--verbose", *FEW
    )
    assert status == 1
    assert "used their budget before they converged" in err
    assert re.search(r"Noise 5 % of the rms frequency \(rms\), [\d.]+ Hz for all modes", out)
    assert "what the plate model gives at the reference constants" in out


def test_noise_is_added_to_the_measured_list_where_that_is_asked_for(run, plate_file, short):
    argv = ("sensitivity", plate_file(PLATE + MEASURED), "--levels", "5", "--reading", "rms")
    document = json.loads(run(*argv, "--list", "measured", "--json", *FEW)[1])
    assert document["frequencies_hz"] == [114, 167, 218, 289, 300, 497]
    assert document["list"] == "measured"
    model = json.loads(run(*argv, "--json", *FEW)[1])
    assert model["frequencies_hz"] != document["frequencies_hz"]
    assert len(model["frequencies_hz"]) == 6


def test_the_same_seed_gives_the_same_document_and_another_seed_another(run, plate_file, short):
    argv = ("sensitivity", plate_file(), "--levels", "5", "--reading", "rms", "--json", *FEW)
    first, again, other = (json.loads(run(*argv, "--seed", seed)[1]) for seed in "334")
    for document in (first, again, other):
        document.pop("seconds")
        document.pop("seed")
    assert first == again
    assert first["levels"] != other["levels"]


def test_a_level_named_twice_is_studied_once(run, plate_file, short):
    argv = ("sensitivity", plate_file(), "--levels", "5", "5.0", "--reading", "rms", "--json", *FEW)
    assert [v["level_percent"] for v in json.loads(run(*argv)[1])["levels"]] == [5.0]


def test_progress_names_the_plate_and_counts_the_tasks(run, plate_file, short):
    argv = ("sensitivity", plate_file(), "--levels", "5", "--reading", "rms", "--groups", "3")
    err = run(*argv, "--executor", "serial")[2]
    assert "sensitivity plate 7: up to 4 iterations" in err
    assert "iteration 4 of 4" in err


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--levels", "0"), "received '0', accepted: a percentage above 0 and at most 50"),
        (("--levels", "1", "50.1"), "received '50.1'"),
        (("--levels", "nan"), "received 'nan'"),
        (("--levels", "five"), "received 'five'"),
        (("--levels",), "expected at least one argument"),
        (("--groups", "1"), "received '1', accepted: a whole number from 2 to 1000"),
        (("--groups", "1001"), "received '1001'"),
        (("--reading", "both ways"), "invalid choice"),
        (("--list", "measured"), "[measurement] is missing, which --list measured needs"),
        (("--executor", "threads"), "executor: received 'threads'"),
        (("--executor", "serial", "--workers", "2"), "number of workers: received 2 with executor serial"),
    ],
)
def test_options_out_of_range_are_refused_with_what_is_accepted(run, plate_file, options, said):
    status, out, err = run("sensitivity", plate_file(), *options)
    assert (status, out) == (2, "")
    assert said in err


@pytest.mark.parametrize(
    ("old", "new", "options", "said"),
    [
        ("[unknowns]\nE1_GPa = [10.0, 200.0]\nnu12 = [0.15, 0.4]\n", "", (), "[unknowns] is missing"),
        ("E1_GPa = 69.0", "E1_GPa = 8.0", (), "material.E1_GPa: 8 lies outside its search bounds 10 to 200"),
        (
            "resolution_hz = 1.0",
            "complete = false",
            ("--list", "measured"),
            "measurement.complete: received false",
        ),
        (
            "",
            "",
            ("--list", "measured", "--modes", "4"),
            "--modes: received 4, accepted: with --list model only",
        ),
        ("width_mm", 'mesh = "plate.msh"\nwidth_mm', (), "plate.mesh"),
    ],
)
def test_plates_that_cannot_be_studied_are_refused(run, plate_file, old, new, options, said):
    path = plate_file((PLATE + MEASURED).replace(old, new, 1))
    status, out, err = run("sensitivity", path, "--executor", "serial", "--quiet", *options)
    assert (status, out) == (2, "")
    assert said in err
