"""`identify --backend emcee` as a user sees it: noise, sizes, labels, priors, stores and their failures."""

import json
from functools import partial
from pathlib import Path

import pytest

from cpam_bayes.cli import prepare
from cpam_bayes.inference.ensemble import DEFAULT_SETTINGS
from cpam_bayes.questions.identify import SampledResult
from cpam_bayes.render.terminal import plain_text
from tests.plate_file import MEASURED, Run, Write, refused
from tests.plate_file import PLATE as WITHOUT_LIST

PLATE = (WITHOUT_LIST + MEASURED).replace(
    "nu12 = [0.15, 0.4]", "nu12 = { mean = 0.3, sd = 0.05, bounds = [0.15, 0.4] }"
)
SIZES = ("[material]", "[plate.sd]\nthickness_mm = 0.03\nwidth_mm = 0.1\n\n[material]")
EMCEE = ("--backend", "emcee", "--quiet", "--steps", "200")


LISTED = "[114, 167, 218, 289, 300, 497]"


@pytest.fixture
def plate_file(plate_file: Write) -> Write:
    """Write the plate file with its list, some words replaced, and return its path."""
    return partial(plate_file, text=PLATE)


@pytest.fixture(scope="module")
def answer(tmp_path_factory: pytest.TempPathFactory) -> SampledResult:
    """The answer for a plate with sizes that have sd, one noise in Hz, and Student-t residuals."""
    path = tmp_path_factory.mktemp("plate") / "plate.toml"
    path.write_text(PLATE.replace(*SIZES), encoding="utf-8")
    options = ("--likelihood", "absolute", "--noise", "student-t")
    argv = ("identify", str(path), *EMCEE, *options)
    finish = prepare(argv)
    assert isinstance(finish, partial)
    found = finish.args[0]()
    assert isinstance(found, SampledResult)
    return found


@pytest.mark.slow
def test_sizes_stand_apart_from_the_constants_in_the_document(answer: SampledResult) -> None:
    document = answer.to_dict()
    assert list(document["constants"]) == ["E1_GPa", "nu12"]
    assert list(document["nuisance"]) == ["width_mm", "thickness_mm"]
    thickness = document["nuisance"]["thickness_mm"]
    assert thickness["reference"] == pytest.approx(3.0)
    assert thickness["mean"] == pytest.approx(3.0, abs=0.02)
    assert thickness["sd"] == pytest.approx(0.03, rel=0.4)  # frequencies say nothing of it beside E1
    (first,) = answer.report().summary.tables
    assert [row[0] for row in first.rows] == ["E1", "nu12"]


@pytest.mark.slow
def test_noise_has_a_scale_and_a_shape(answer: SampledResult) -> None:
    document = answer.to_dict()
    assert document["noise"]["name"] == "absolute_sd_hz"
    assert 0.5 < document["noise"]["mean"] < 20.0
    assert document["degrees_of_freedom"] == 4.0
    assert any(
        "Hz, inferred, Student-t with 4" in plain_text(table)
        for section in answer.report().sections
        for table in section.tables
        if table.rows
    )


LABELLED = ("resolution_hz = 1.0", 'labels = ["(1,1)", "", "", "(9,9)", "", ""]')
REFUSED = {
    "absolute and relative_std": (
        ("resolution_hz = 1.0", "relative_std = 0.01"),
        (*EMCEE, "--likelihood", "absolute"),
        "measurement.relative_std: the absolute likelihood infers",
    ),
    "label": (
        LABELLED,
        EMCEE,
        "measurement.labels: received '(9,9)' for one frequency, no mode of the model has it",
    ),
    "label and swarm": (LABELLED, ("--quiet",), "(1,1) at 11"),
    "control character": (
        ("plate 7", "plate \\u001b[31m7"),
        EMCEE,
        r'name: malformed, received "plate \u001b',
    ),
    "direction mark": (("plate 7", "plate \\u202e7"), EMCEE, r"\u202e7"),
}


@pytest.mark.parametrize(("change", "options", "said"), REFUSED.values(), ids=REFUSED)
def test_what_cannot_be_is_refused_in_one_line(
    run: Run, plate_file: Write, change: tuple[str, str], options: tuple[str, ...], said: str
) -> None:
    answer = run("identify", plate_file(change), *options)
    refused(answer, said)
    assert answer[2].replace("\n", "").isprintable()


def test_the_help_names_the_settings_that_the_chains_have(run: Run) -> None:
    _, out, _ = run("identify", "--help")
    said = f"in rounds of {DEFAULT_SETTINGS.round_steps} (default: {DEFAULT_SETTINGS.most_steps})"
    assert said in " ".join(out.split())


@pytest.mark.slow
@pytest.mark.parametrize("options", [EMCEE, ("--quiet",)])
def test_labels_put_modes_beside_their_frequencies(
    run: Run, plate_file: Write, options: tuple[str, ...]
) -> None:
    labels = 'labels = ["(1,1)", "", "", "(1,2)", "(2,1)", ""]'  # the model has them the other way round
    rows = json.loads(run("identify", plate_file(("resolution_hz = 1.0", labels)), *options, "--json")[1])
    fourth, fifth = rows["frequencies"][3:5]
    assert (fourth["label"], fifth["label"]) == ("(1,2)", "(2,1)")
    assert fourth["predicted_hz"] > fifth["predicted_hz"]


@pytest.mark.slow
def test_a_store_of_another_problem_is_refused_and_a_damaged_round_is_sampled_again(
    run: Run, plate_file: Write, tmp_path: Path
) -> None:
    store = tmp_path / "store"
    command = ("identify", plate_file(), *EMCEE[:-1], "40", "--store", str(store))
    answer = json.loads(run(*command, "--json")[1])
    first = store / "round_0000.arrays"
    status, out, err = run(*command, "--noise", "student-t")
    assert (status, out) == (2, "")
    assert "holds another problem" in err
    first.write_bytes(first.read_bytes()[:700])
    status, out, err = run(*command, "--json")
    assert json.loads(out)["constants"] == answer["constants"]
    assert f"warning: {first} was damaged: it is set aside as round_0000.arrays.damaged" in err


@pytest.mark.slow
def test_a_full_disk_costs_the_store_and_not_the_answer(
    run: Run, plate_file: Write, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    replace = Path.replace

    def full(self: Path, target: Path) -> Path:
        if self.parent.name == "store":
            raise OSError(28, "No space left on device")
        return replace(self, target)

    monkeypatch.setattr(Path, "replace", full)
    stored = ("--steps", "40", "--json", "--store", tmp_path / "store", "--noise", "gaussian")
    status, out, err = run("identify", plate_file(), *EMCEE, *stored)
    assert status == 1
    document = json.loads(out)
    assert document["constants"]["E1_GPa"]["mean"] == pytest.approx(68.0, abs=3.0)
    assert any("cannot be written (No space left on device)" in text for text in document["warnings"])
    assert "cannot be written" in err


@pytest.mark.slow
@pytest.mark.parametrize(
    ("changes", "said"),
    [
        (((LISTED, "[114]"),), ("1 frequency for 2 unknowns",)),
        (
            ((LISTED, "[114, 167, 289, 300, 497]"), ("resolution_hz = 1.0", "relative_std = 0.01")),
            ("to lack the mode (2,0)+(0,2) near 2", "modes may be missing from it"),
        ),
    ],
)
def test_a_list_that_is_too_short_or_lacks_a_mode_is_put_in_doubt(
    run: Run, plate_file: Write, changes: tuple[tuple[str, str], ...], said: tuple[str, ...]
) -> None:
    status, _, err = run("identify", plate_file(*changes), *EMCEE)
    assert status in (0, 1)
    assert [part for part in said if part not in err] == []
