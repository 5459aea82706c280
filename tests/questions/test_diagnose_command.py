"""`diagnose` as a user sees it: plates that it takes and refuses, documents, files, progress."""

import json
import re

import pytest

import cpam_bayes as cb
from tests.diagnosed import CHEAP
from tests.plate_file import refused


@pytest.mark.parametrize(
    ("plates", "said"),
    [
        (("A1", "A1"), "received A1 twice"),
        (("A1", "C1"), "material carbon/epoxy, while A1 has aluminium"),
    ],
)
def test_plates_that_are_not_several_of_one_material_are_refused(run, plates, said):
    refused(run("diagnose", *plates), said)


@pytest.mark.usefixtures("few_causes")
def test_json_is_one_document_progress_goes_to_standard_error_and_files_to_the_directory(
    run, plate_file, tmp_path
):
    status, out, err = run("diagnose", plate_file(), "--json", "--seed", "5", "--out", tmp_path / "out")
    assert status == 0
    assert re.search(r"\d of \d+ hypotheses", err)
    first = json.loads(out)
    written = {path.name for path in (tmp_path / "out").rglob("*") if path.is_file()}
    assert {"diagnose.json", "report.html", "residuals.png", "causes.svg"} <= written
    assert json.loads((tmp_path / "out" / "diagnose.json").read_text("utf-8")) == first
    assert {h["cause"] for h in first["hypotheses"]} == CHEAP
    assert first["air_density_kg_m3"] == {"plate 7": None}
    assert {entry["cause"] for entry in first["detectable"]} == CHEAP - {"none", "other"}
    assert isinstance(first["claim_stands"], bool)


@pytest.mark.usefixtures("few_causes")
def test_the_prior_of_none_is_an_option_and_the_others_keep_their_proportions(run, plate_file):
    path = plate_file()
    as_is, asked = (
        json.loads(run("diagnose", path, "--json", "--quiet", "--next", "never", *more)[1])
        for more in ((), ("--prior-none", "0.9"))
    )
    for document, prior in ((as_is, 0.5), (asked, 0.9)):
        assert document["priors"]["none"] == prior
        assert document["next_measurement"] == []
        assert 0.0 < document["basis_error"] < 1e-4
    before, after = ({h["cause"]: h["prior"] for h in d["hypotheses"]} for d in (as_is, asked))
    ratios = [after[name] / before[name] for name in before if name != "none"]
    assert ratios == pytest.approx([0.2] * len(ratios))
    # odds change as the priors do, but for the hypotheses that a first look then suffices for: 0.1 nats
    odds = [next(h["probability"] for h in d["hypotheses"] if h["cause"] == "none") for d in (as_is, asked)]
    assert odds[1] / (1 - odds[1]) == pytest.approx(9 * odds[0] / (1 - odds[0]), rel=0.15)


@pytest.mark.usefixtures("few_causes")
def test_air_in_the_file_is_part_of_the_model_and_no_cause(plate_file):
    path = plate_file(("[measurement]", "[environment]\nair_density_kg_m3 = 1.2\n\n[measurement]"))
    document = cb.diagnose(path, next_test="never").to_dict()
    assert document["air_density_kg_m3"] == {"plate 7": 1.2}
    assert "air" not in document["inclusion"]
