"""The library as a Python caller sees it: the same answers, refusals and warnings as the commands give."""

import ast
import doctest
import inspect
import json
import math
import pickle
import subprocess
import sys
import tomllib
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import cpam_bayes as cb
from cpam_bayes.errors import ArgumentError, PlateFileError
from cpam_bayes.inference.ensemble import DEFAULT_SETTINGS
from cpam_bayes.questions.forward import ForwardResult
from cpam_bayes.questions.identify.pso import PointResult
from tests.answers import answered
from tests.plate_file import MEASURED, PLATE, Run, Write

# A limit on the time is no question.
VERBS = [name for name in cb.__all__ if inspect.isfunction(getattr(cb, name)) and name != "time_limit"]
EXAMPLES = [*VERBS, "time_limit"]


@pytest.fixture(scope="module")
def point() -> PointResult:
    return answered("identify")


@pytest.fixture(scope="module")
def modes() -> ForwardResult:
    return cb.forward("A1", 2)


def test_the_public_names_are_those_that_are_loaded_and_those_that_type_checkers_see() -> None:
    tree = ast.parse(Path(cb.__file__).read_text("utf-8"))
    (annotations,) = (node for node in tree.body if isinstance(node, ast.If))
    imported = {
        alias.asname or alias.name: (statement.module, alias.name)
        for statement in annotations.body
        if isinstance(statement, ast.ImportFrom)
        for alias in statement.names
    }
    loaded = {name: (module, name) for name, module in cb._PUBLIC.items()}
    assert imported == loaded | {name: ("cpam_bayes", name) for name in cb._PACKAGES}
    assert cb.__all__ == sorted(imported)
    assert set(cb.__all__) <= set(dir(cb))


def test_every_verb_is_a_function_after_all_modules_are_imported() -> None:
    code = f"""
import importlib, inspect, pkgutil
import cpam_bayes as cb
for module in pkgutil.walk_packages(cb.__path__, "cpam_bayes."):
    if not module.name.endswith("__main__"):
        importlib.import_module(module.name)
print([name for name in {VERBS * 2!r} if not inspect.isfunction(getattr(cb, name))])
"""
    assert subprocess.check_output([sys.executable, "-c", code], text=True, timeout=120) == "[]\n"


# What is changed in the aluminium plate and its list.
NO_LIST = (MEASURED, "")
NO_UNKNOWNS = ("[unknowns]\nE1_GPa = [10.0, 200.0]\nnu12 = [0.15, 0.4]\n", "")
GAPS = ("resolution_hz = 1.0", "complete = false")
LABELS = ("resolution_hz = 1.0", 'labels = ["(1,1)", "", "", "", "", ""]')
ANGLES = ('edges = "FFFF"', 'edges = "FFFF"\nlayup = "[?/0]_s"')
CARBON = ("isotropic = true\nE1_GPa = 69.0\n", "E1_GPa = 121.2\nE2_GPa = 9.34\nG12_GPa = 6.25\n")
MESH = ('edges = "FFFF"', 'edges = "FFFF"\nmesh = "plate.msh"')
AIR = ("[measurement]", "[environment]\nair_density_kg_m3 = 1.2\n[measurement]")
THIN = ("thickness_mm = 3.0", "thickness_mm = 0.003")
NARROW = ("E1_GPa = [10.0, 200.0]", "E1_GPa = [10.0, 60.0]")
KNOWN = ("nu12 = 0.33\n", "nu12 = 0.33\n[material.sd]\nE1_GPa = 0.1\n")
NO_WIDTH = ("280.0", "nan")
SD_OF_EACH = ("resolution_hz = 1.0", "frequency_sd_hz = [1, 1, 1, 1, 1, 1]")
TO_CCX = partial(cb.export, path="x.inp"), "export --to ccx --out x.inp"
BY_CCX = partial(cb.forward, solver="ccx"), "forward --solver ccx"
BY_PSO, BY_EMCEE = (cb.identify, "identify --backend pso"), (cb.sample, "identify --backend emcee")
OF_THE_LIST = partial(cb.sensitivity, source="measured"), "sensitivity --list measured"
IDENTIFY, DIAGNOSE = (cb.identify, "identify"), (cb.diagnose, "diagnose")
REPORT, SENSITIVITY = (cb.report, "report --out out"), (cb.sensitivity, "sensitivity")
FORWARD, SEQUENCE, CALIBRATE = (cb.forward, "forward"), (cb.sequence, "sequence"), (cb.calibrate, "calibrate")

REFUSED_PLATES: list[tuple[tuple[tuple[str, str], ...], tuple[Callable[..., object], str], str]] = [
    ((GAPS,), BY_PSO, "measurement.complete: received false, this version pairs the first model mode"),
    ((GAPS,), OF_THE_LIST, "measurement.complete: received false, --list measured adds noise to a list"),
    ((NO_LIST,), IDENTIFY, "[measurement] is missing, nothing to identify from"),
    ((NO_LIST,), BY_EMCEE, "[measurement] is missing"),
    ((NO_LIST,), DIAGNOSE, "[measurement] is missing, nothing to be compared with the model"),
    ((NO_LIST,), REPORT, "[measurement] is missing"),
    ((NO_LIST,), OF_THE_LIST, "[measurement] is missing, which --list measured needs"),
    ((NO_LIST,), CALIBRATE, "calibrate needs [unknowns], and a list in [measurement]"),
    ((NO_UNKNOWNS,), IDENTIFY, "[unknowns] is missing, nothing to identify"),
    ((NO_UNKNOWNS,), DIAGNOSE, "[unknowns] is missing; name the constants that may differ"),
    ((NO_UNKNOWNS,), REPORT, "[unknowns] is missing"),
    ((NO_UNKNOWNS,), SENSITIVITY, "[unknowns] is missing, nothing to identify"),
    ((NO_UNKNOWNS,), (cb.design, "design"), "[unknowns] is missing; name the constants to be determined"),
    (
        (SD_OF_EACH,),
        CALIBRATE,
        "measurement.frequency_sd_hz: calibrate takes one repeatability for all modes; state relative_std",
    ),
    ((MESH,), IDENTIFY, "plate.msh, identify computes rectangular plates only; leave mesh out, or"),
    ((MESH,), BY_EMCEE, "identify computes rectangular plates only; leave mesh out, or"),
    ((MESH,), DIAGNOSE, "diagnose computes rectangular plates only; leave mesh out"),
    ((MESH,), SENSITIVITY, "sensitivity computes rectangular plates only; leave mesh out"),
    ((MESH,), (partial(cb.forward, solver="ritz"), "forward --solver ritz"), "--solver ritz computes rect"),
    ((MESH,), BY_CCX, "--solver ccx computes rectangular plates only; use --solver fem"),
    ((MESH,), TO_CCX, "files are written for rectangular plates only; leave mesh out"),
    ((MESH, AIR), FORWARD, "air_density_kg_m3: received 1.2, the air about a plate with a mesh is not"),
    ((AIR,), BY_CCX, "air_density_kg_m3: received 1.2, CalculiX computes plates in vacuum"),
    ((AIR,), TO_CCX, "air_density_kg_m3: received 1.2, decks hold a plate in vacuum"),
    ((ANGLES,), FORWARD, "plate.layup: received [?/0]_s, unknown angles: 1; a known layup is needed"),
    ((ANGLES,), DIAGNOSE, "unknown angles: 1; a known layup is needed"),
    ((ANGLES, CARBON), BY_EMCEE, "let `sequence` or `identify --backend pso` find them"),
    ((ANGLES,), IDENTIFY, "the material is isotropic, which has no ply angles; leave layup out"),
    ((ANGLES,), SEQUENCE, "the material is isotropic, which has no ply angles; leave layup out"),
    ((ANGLES, CARBON, LABELS), IDENTIFY, "measurement.labels: received beside unknown angles"),
    ((ANGLES, CARBON, LABELS), SEQUENCE, "measurement.labels: received beside unknown angles"),
    ((), SEQUENCE, 'plate.layup: received [0], none of its angles is "?"'),
    ((("E1_GPa = 69.0", "E1_GPa = 8.0"),), SENSITIVITY, "material.E1_GPa: 8 lies outside its search bounds"),
    ((NARROW, KNOWN), DIAGNOSE, "unknowns.E1: its bounds leave nothing within 4 standard deviations"),
    ((THIN,), IDENTIFY, "plate.thickness_mm: received 0.003, 1/100000 of the longer side, too thin"),
    ((("300.0", "0.0"), NO_WIDTH), FORWARD, "plate.width_mm: not a finite number"),
]


@pytest.mark.parametrize(
    ("changes", "question", "said"), REFUSED_PLATES, ids=[f"{q[1]}: {said}" for _, q, said in REFUSED_PLATES]
)
def test_a_plate_is_refused_by_a_question_with_the_text_of_its_command(
    run: Run,
    plate_file: Write,
    tmp_path: Path,
    changes: tuple[tuple[str, str], ...],
    question: tuple[Callable[..., object], str],
    said: str,
) -> None:
    call, (name, *options) = question[0], question[1].split()
    (tmp_path / "plate.msh").touch()
    path = plate_file(*changes)
    with pytest.raises(ValueError, match=r"plate\.toml") as refused:
        call(path)
    assert said in str(refused.value)
    status, out, err = run(name, path, *options, "--quiet")
    assert (status, out) == (2, "")
    assert err == "".join(f"error: {line}\n" for line in str(refused.value).splitlines())


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda: cb.paper(15), "table: received 15, accepted: a whole number from 1 to 14"),
        (lambda: cb.new(""), "FILE: received '', accepted: the file to write"),
        (lambda: cb.diagnose(), "plates: received none, accepted: one plate or more"),
        (lambda: cb.diagnose(*["A1"] * 51), "plates: received 51, accepted: one plate or more, 50 at most"),
        (lambda: cb.forward("A1", solver="abaqus"), "solver: received 'abaqus', accepted: ritz fem ccx"),
        (lambda: cb.identify("A1", residuals="x"), "residuals: received 'x', accepted: absolute relative"),
        (lambda: cb.sensitivity("A1", source="x"), "source: received 'x', accepted: measured model"),
        (lambda: cb.sensitivity("A1", readings="x"), "readings: received 'x', accepted: relative rms"),
        (lambda: cb.sensitivity("A1", readings=[]), "readings: received '', accepted: relative rms"),
        (lambda: cb.sensitivity("A1", levels=[5.0]), "levels, as fractions: received 5.0, accepted"),
        (lambda: cb.sensitivity("A1", levels=[]), "levels, as fractions: received 0.0, accepted"),
        (lambda: cb.sensitivity("A1", levels=[math.nan]), "levels, as fractions: received nan, accepted"),
        (lambda: cb.sensitivity("A1", groups=1), "groups: received 1, accepted: a whole number from 2"),
        (lambda: cb.forward("A1", n_modes=0), "n_modes: received 0, accepted: a whole number from 1 to 100"),
        (
            lambda: cb.export("A1", n_modes=101),
            "n_modes: received 101, accepted: a whole number from 1 to 100",
        ),
        (lambda: cb.sample("A1", seed=-1), "seed: received -1, accepted: a whole number from 0"),
        (lambda: cb.sample("A1", likelihood="x"), "likelihood: received 'x', accepted: relative absolute"),
        (lambda: cb.posterior("A1", likelihood="x"), "likelihood: received 'x'"),
        (lambda: cb.sequence("C1", top=0), "top: received 0, accepted: a whole number from 1 to 2000"),
        (lambda: cb.diagnose("A1", next_test="x"), "next_test: received 'x', accepted: open always never"),
        (lambda: cb.diagnose("A1", scatter=-1.0), "scatter: received -1.0, accepted: a number above 0"),
        (lambda: cb.diagnose("A1", prior_none=2.0), "prior_none: received 2.0, accepted: a number above 0"),
    ],
)
def test_arguments_out_of_range_are_refused(call: Callable[[], object], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        call()


# A value that is of no type of an annotation of the verbs.
NOTHING = object()


@pytest.mark.parametrize("name", [name for name in VERBS if name not in ("plates", "builtin_plates")])
def test_an_argument_of_a_wrong_type_is_named_before_any_work(name: str) -> None:
    verb = getattr(cb, name)
    parameters = inspect.signature(verb).parameters.values()
    several = [p.name for p in parameters if p.kind is p.VAR_POSITIONAL]
    needed = [*(p.name for p in parameters if p.default is p.empty and p.name not in several), *several]
    for parameter in parameters:
        for value in (NOTHING, 1j, b"C1"):
            given = [value if name == parameter.name else "A1" for name in needed]
            more = {} if parameter.name in needed else {parameter.name: value}
            with pytest.raises(ValueError, match=f"^{parameter.name}: received .*, accepted: ") as refused:
                verb(*given, **more)
            assert isinstance(refused.value, TypeError)


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda: cb.identify("A1", seed=None), "seed: received None, accepted: a whole number"),
        (lambda: cb.identify("A1", seed=True), "seed: received True, accepted: a whole number"),
        (lambda: cb.export("A1", n_modes=2.5), "n_modes: received 2.5, accepted: a whole number or None"),
        (
            lambda: cb.forward(None),
            "plate: received None, accepted: a text or a path or a mapping or a Specimen",
        ),
        (lambda: cb.diagnose("A1", 3), "plates: received 3, accepted: a text or a path or a mapping"),
        (lambda: cb.diagnose("A1", prior_none="a"), "prior_none: received 'a', accepted: a number or None"),
        (
            lambda: cb.sensitivity("A1", levels=0.01),
            "levels: received 0.01, accepted: a sequence of which each is a number",
        ),
        (lambda: cb.identify("A1", settings={}), "settings: received {}, accepted: a SwarmSettings or None"),
        (lambda: cb.identify("A1", watch=print), "watch: received <built-in .*, accepted: a Watch"),
        (
            lambda: cb.design("A1", constants="nu12"),
            r"constants: received 'nu12', accepted: .*as \['nu12'\]$",
        ),
        (lambda: cb.plates().save(None), "directory: received None, accepted: a text or a path"),
    ],
)
def test_what_is_said_of_a_wrong_type(call: Callable[[], object], said: str) -> None:
    with pytest.raises(ArgumentError, match=f"^{said}"):
        call()


def test_a_plate_can_be_given_as_its_content_in_lists_tuples_or_arrays(plate_file: Write) -> None:
    content = tomllib.loads(PLATE + MEASURED)
    specimen, from_file = cb.read_plate(content), cb.read_plate(plate_file())
    assert repr(replace(specimen, source=from_file.source)) == repr(from_file)
    assert cb.read_plate(specimen) is specimen
    content["measurement"]["frequencies_hz"] = np.array(content["measurement"]["frequencies_hz"])
    content["unknowns"] = {name: tuple(bounds) for name, bounds in content["unknowns"].items()}
    content["plate"]["length_mm"] = np.float32(content["plate"]["length_mm"])
    assert repr(cb.read_plate(content)) == repr(specimen)
    content["plate"]["width_m"] = 0.28
    with pytest.raises(PlateFileError, match=r"plate\.width_m: unknown key, the nearest known .* width_mm"):
        cb.forward(content)
    del content["plate"]["width_m"]
    content["measurement"]["frequencies_hz"] = np.array([[114.0, 167.0]])
    with pytest.raises(PlateFileError, match="frequencies_hz item 1: wrong type"):
        cb.read_plate(content)


def test_what_is_not_there_is_left_to_python_and_numbers_of_numpy_are_numbers() -> None:
    with pytest.raises(AttributeError, match="no attribute 'anneal'"):
        cb.anneal  # noqa: B018
    with pytest.raises(TypeError, match="unexpected keyword argument 'mode'"):
        cb.forward("A1", mode=3)
    with pytest.raises(TypeError, match="missing 1 required positional argument: 'plate'"):
        cb.forward()
    computed = cb.forward("A1", np.int64(1), seed=np.int32(3))
    assert cb.forward(plate="A1", n_modes=1).frequencies == computed.frequencies


def without_seconds(value: Any) -> Any:
    """A document without how long things took."""
    if isinstance(value, dict):
        timed = ("seconds", "per_second")
        return {k: without_seconds(v) for k, v in value.items() if not any(t in k for t in timed)}
    return [without_seconds(v) for v in value] if isinstance(value, list) else value


SHORT = replace(DEFAULT_SETTINGS, most_steps=20, round_steps=20)


@pytest.mark.usefixtures("few_causes")
@pytest.mark.parametrize(
    ("call", "argv"),
    [
        (cb.forward, ("forward",)),
        (partial(cb.identify, residuals="relative"), ("identify", "--residuals", "relative")),
        pytest.param(cb.diagnose, ("diagnose",), marks=pytest.mark.slow),
        pytest.param(
            partial(cb.sample, settings=SHORT),
            ("identify", "--backend", "emcee", "--steps", "20"),
            marks=pytest.mark.slow,
        ),
    ],
)
def test_a_call_gives_the_document_warnings_and_status_of_its_command(
    run: Run, plate_file: Write, call: Callable[..., cb.Result], argv: tuple[str, ...]
) -> None:
    path = plate_file(("resolution_hz = 1.0", "relative_std = 0.0001"))
    result = call(path, seed=2)
    status, out, err = run(argv[0], path, *argv[1:], "--seed", "2", "--json", "--quiet")
    assert err == "".join(f"warning: {warning}\n" for warning in result.warnings)
    assert status == (0 if result.reached_goal else 1)
    document = result.to_dict()
    assert document["warnings"] == list(result.warnings)
    assert without_seconds(json.loads(out)) == without_seconds(document)


def test_a_result_is_one_line_equal_to_itself_alone_and_draws_what_is_asked_for(
    point: PointResult, modes: ForwardResult, run: Run
) -> None:
    assert repr(point) == "<PointResult of identify A1: converged, warnings: 1>"
    assert (point.status, point.reached_goal, point.title) == ("converged", True, "A1")
    assert (modes.status, modes.warnings) == ("done", ())
    assert modes.summary() == run("forward", "A1", "--modes", "2", "--quiet")[1]
    again = pickle.loads(pickle.dumps(point))
    assert point == point
    assert point != again  # arrays have no truth value to compare results by
    assert again.to_dict() == point.to_dict()
    assert list(point.figures()) == ["residuals", "predicted_against_measured", "modes", "plate"]
    assert "residuals" in point.plot().axes[0].get_title("left")
    assert point.plot("predicted_against_measured").axes[0].get_xlabel() == "measured, Hz"
    assert len(modes.plot().axes) == 2
    with pytest.raises(ValueError, match="received 'causes', accepted: residuals predicted_against_measured"):
        point.plot("causes")
    with pytest.raises(ValueError, match="accepted: nothing to be drawn"):
        cb.plates().plot()
    with pytest.raises(ValueError, match="to_arviz: forward has no draws"):
        modes.to_arviz()


def test_saving_writes_the_files_of_the_command(point: PointResult, tmp_path: Path) -> None:
    out = tmp_path / "new" / "results"
    point.save(out)
    names = ("predicted_against_measured", "residuals", "modes", "plate")
    files = {"identify.json", "posterior.nc", "report.html"}
    files |= {f"figures/{n}.{e}" for n in names for e in ("png", "svg")}
    assert {str(p.relative_to(out)) for p in out.rglob("*") if p.is_file()} == files
    assert json.loads((out / "identify.json").read_text("utf-8")) == point.to_dict()
    with pytest.raises(ValueError, match="a file, accepted: a directory"):
        point.save(out / "identify.json")


# The same calls with other seeds, which other tests make, are marked weekly.
MARKS = {
    "sample": (pytest.mark.slow,),
    **dict.fromkeys(
        ("calibrate", "diagnose", "report", "sensitivity", "sequence"), (pytest.mark.slow, pytest.mark.weekly)
    ),
}


@pytest.mark.parametrize("name", [pytest.param(name, marks=MARKS.get(name, ())) for name in EXAMPLES])
def test_the_examples_give_what_they_show(name: str) -> None:
    module = import_module(cb._PUBLIC[name])
    (example,) = doctest.DocTestFinder(recurse=False).find(getattr(cb, name), name, module)
    assert example.examples
    assert doctest.DocTestRunner(optionflags=doctest.NORMALIZE_WHITESPACE).run(example).failed == 0


def test_examples_stand_at_the_verbs_alone() -> None:
    found = {
        example.name
        for module in sorted(set(cb._PUBLIC.values()))
        for example in doctest.DocTestFinder().find(import_module(module))
        if example.examples
    }
    assert found == {f"{cb._PUBLIC[name]}.{name}" for name in EXAMPLES}


def test_a_name_with_a_slash_makes_no_path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    named = tomllib.loads(PLATE + MEASURED) | {"name": "batch 3/plate 7"}
    cb.forward(named, n_modes=2).save(tmp_path / "forward")
    assert str(cb.export(named).path) == "batch_3_plate_7.inp"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["batch_3_plate_7.inp", "forward"]
