"""The library as a Python caller sees it: the same answers, refusals and warnings as the commands."""

import ast
import doctest
import inspect
import json
import math
import pickle
import subprocess
import sys
import tomllib
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
from tests.answers import answered
from tests.plate_file import MEASURED, PLATE

# A time limit is no question.
VERBS = [name for name in cb.__all__ if inspect.isfunction(getattr(cb, name)) and name != "time_limit"]
EXAMPLES = [*VERBS, "time_limit"]
# Changes to the aluminium plate and its list.
NO_LIST = (MEASURED, "")
NO_UNKNOWNS = ("[unknowns]\nE1_GPa = [10.0, 200.0]\nnu12 = [0.15, 0.4]\n", "")
GAPS = ("resolution_hz = 1.0", "complete = false")
LABELS = ("resolution_hz = 1.0", 'labels = ["(1,1)", "", "", "", "", ""]')
ANGLES = ('edges = "FFFF"', 'edges = "FFFF"\nlayup = "[?/0]_s"')
CARBON = ("isotropic = true\nE1_GPa = 69.0\n", "E1_GPa = 121.2\nE2_GPa = 9.34\nG12_GPa = 6.25\n")
MESH = ('edges = "FFFF"', 'edges = "FFFF"\nmesh = "plate.msh"')
AIR = ("[measurement]", "[environment]\nair_density_kg_m3 = 1.2\n[measurement]")
THIN, NO_WIDTH = ("thickness_mm = 3.0", "thickness_mm = 0.003"), ("280.0", "nan")
NARROW = ("E1_GPa = [10.0, 200.0]", "E1_GPa = [10.0, 60.0]")
KNOWN = ("nu12 = 0.33\n", "nu12 = 0.33\n[material.sd]\nE1_GPa = 0.1\n")
SD_OF_EACH = ("resolution_hz = 1.0", "frequency_sd_hz = [1, 1, 1, 1, 1, 1]")
ONE_SD, NO_ANGLES = "one repeatability for all modes", "which has no ply angles"
TO_CCX = partial(cb.export, path="x.inp"), "export --to ccx --out x.inp"
BY_CCX = partial(cb.forward, solver="ccx"), "forward --solver ccx"
BY_PSO, BY_EMCEE = (cb.identify, "identify --backend pso"), (cb.sample, "identify --backend emcee")
OF_THE_LIST = partial(cb.sensitivity, source="measured"), "sensitivity --list measured"
IDENTIFY, DIAGNOSE = (cb.identify, "identify"), (cb.diagnose, "diagnose")
REPORT, SENSITIVITY = (cb.report, "report --out out"), (cb.sensitivity, "sensitivity")
FORWARD, SEQUENCE, CALIBRATE = (cb.forward, "forward"), (cb.sequence, "sequence"), (cb.calibrate, "calibrate")
OF_ANGLES, BESIDE = (IDENTIFY, SEQUENCE), "received beside unknown angles"
REFUSED_PLATES = [
    ((GAPS,), BY_PSO, "measurement.complete: received false, this version pairs the first model mode"),
    ((GAPS,), OF_THE_LIST, "measurement.complete: received false, --list measured needs a list"),
    ((NO_LIST,), IDENTIFY, "[measurement] is missing, nothing to identify from"),
    *(((NO_LIST,), q, "[measurement] is missing") for q in (BY_EMCEE, REPORT)),
    ((NO_LIST,), DIAGNOSE, "[measurement] is missing, nothing to be compared with the model"),
    ((NO_LIST,), OF_THE_LIST, "[measurement] is missing; --list measured needs it"),
    ((NO_LIST,), CALIBRATE, "calibrate needs [unknowns], and a list in [measurement]"),
    *(((NO_UNKNOWNS,), q, "[unknowns] is missing, nothing to identify") for q in (IDENTIFY, SENSITIVITY)),
    ((NO_UNKNOWNS,), DIAGNOSE, "[unknowns] is missing; name the constants that may differ"),
    ((NO_UNKNOWNS,), REPORT, "[unknowns] is missing"),
    ((NO_UNKNOWNS,), (cb.design, "design"), "[unknowns] is missing; name the constants to be determined"),
    ((SD_OF_EACH,), CALIBRATE, f"measurement.frequency_sd_hz: calibrate takes {ONE_SD}; state relative_std"),
    ((MESH,), IDENTIFY, "plate.msh, identify computes rectangular plates only; leave mesh out, or"),
    ((MESH,), BY_EMCEE, "identify computes rectangular plates only; leave mesh out, or"),
    ((MESH,), DIAGNOSE, "diagnose computes rectangular plates only; leave mesh out"),
    ((MESH,), SENSITIVITY, "sensitivity computes rectangular plates only; leave mesh out"),
    ((MESH,), (partial(cb.forward, solver="ritz"), "forward --solver ritz"), "--solver ritz computes rect"),
    ((MESH,), BY_CCX, "--solver ccx computes rectangular plates only; use --solver fem"),
    ((MESH,), TO_CCX, "files are written for rectangular plates only; leave mesh out"),
    ((MESH, AIR), FORWARD, "air_density_kg_m3: received 1.2, the air about a plate with a mesh is not"),
    ((AIR,), BY_CCX, "air_density_kg_m3: received 1.2, CalculiX computes plates in vacuum"),
    ((AIR,), TO_CCX, "air_density_kg_m3: received 1.2, decks model a plate in vacuum"),
    ((ANGLES,), FORWARD, "plate.layup: received [?/0]_s, unknown angles: 1; a known layup is needed"),
    ((ANGLES,), DIAGNOSE, "unknown angles: 1; a known layup is needed"),
    ((ANGLES, CARBON), BY_EMCEE, "let `sequence` or `identify --backend pso` find them"),
    *(((ANGLES,), q, f"the material is isotropic, {NO_ANGLES}; leave layup out") for q in OF_ANGLES),
    *(((ANGLES, CARBON, LABELS), q, f"measurement.labels: {BESIDE}") for q in OF_ANGLES),
    ((), SEQUENCE, 'plate.layup: received [0], none of its angles is "?"'),
    ((("E1_GPa = 69.0", "E1_GPa = 8.0"),), SENSITIVITY, "material.E1_GPa: 8 lies outside its search bounds"),
    ((NARROW, KNOWN), DIAGNOSE, "unknowns.E1: its bounds leave nothing within 4 standard deviations"),
    ((THIN,), IDENTIFY, "plate.thickness_mm: received 0.003, 1/100000 of the longer side, too thin"),
    ((("300.0", "0.0"), NO_WIDTH), FORWARD, "plate.width_mm: not a finite number"),
]
IDS = [f"{question[1]}: {said}" for _, question, said in REFUSED_PLATES]
A_PLATE = "accepted: a text or a path or a mapping"
NUMBERS = "accepted: a sequence of which each is a number"
TO_100 = "accepted: a whole number from 1 to 100"
# A value of no type annotated in the verbs.
NOTHING = object()
SHORT = replace(DEFAULT_SETTINGS, most_steps=20, round_steps=20)
EMCEE = ("identify", "--backend", "emcee", "--steps", "20")
CALLS = [
    (cb.forward, ("forward",)),
    (partial(cb.identify, residuals="relative"), ("identify", "--residuals", "relative")),
    pytest.param(cb.diagnose, ("diagnose",), marks=pytest.mark.slow),
    pytest.param(partial(cb.sample, settings=SHORT), EMCEE, marks=pytest.mark.slow),
]
# covered by tests with other seeds
WEEKLY = ("calibrate", "diagnose", "report", "sensitivity", "sequence")
MARKS = dict.fromkeys(WEEKLY, (pytest.mark.slow, pytest.mark.weekly)) | {"sample": (pytest.mark.slow,)}
REFUSED_CALLS = [
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
    (lambda: cb.forward("A1", n_modes=0), f"n_modes: received 0, {TO_100}"),
    (lambda: cb.export("A1", n_modes=101), f"n_modes: received 101, {TO_100}"),
    (lambda: cb.sample("A1", seed=-1), "seed: received -1, accepted: a whole number from 0"),
    (lambda: cb.sample("A1", likelihood="x"), "likelihood: received 'x', accepted: relative absolute"),
    (lambda: cb.posterior("A1", likelihood="x"), "likelihood: received 'x'"),
    (lambda: cb.sequence("C1", top=0), "top: received 0, accepted: a whole number from 1 to 2000"),
    (lambda: cb.diagnose("A1", next_test="x"), "next_test: received 'x', accepted: open always never"),
    (lambda: cb.diagnose("A1", scatter=-1.0), "scatter: received -1.0, accepted: a number above 0"),
    (lambda: cb.diagnose("A1", prior_none=2.0), "prior_none: received 2.0, accepted: a number above 0"),
    (lambda: cb.identify("A1", seed=None), "seed: received None, accepted: a whole number"),
    (lambda: cb.identify("A1", seed=True), "seed: received True, accepted: a whole number"),
    (lambda: cb.export("A1", n_modes=2.5), "n_modes: received 2.5, accepted: a whole number or None"),
    (lambda: cb.forward(None), f"plate: received None, {A_PLATE} or a Specimen"),
    (lambda: cb.diagnose("A1", 3), f"plates: received 3, {A_PLATE}"),
    (lambda: cb.diagnose("A1", prior_none="a"), "prior_none: received 'a', accepted: a number or None"),
    (lambda: cb.sensitivity("A1", levels=0.01), f"levels: received 0.01, {NUMBERS}"),
    (lambda: cb.identify("A1", settings={}), "settings: received {}, accepted: a SwarmSettings or None"),
    (lambda: cb.identify("A1", watch=print), "watch: received <built-in .*, accepted: a Watch"),
    (lambda: cb.design("A1", constants="E1"), r"constants: received 'E1', accepted: .*as \['E1'\]$"),
]


def test_the_public_names_are_those_that_are_loaded_and_those_that_type_checkers_see():
    tree = ast.parse(Path(cb.__file__).read_text("utf-8"))
    (annotations,) = (node for node in tree.body if isinstance(node, ast.If))
    found = [node for node in annotations.body if isinstance(node, ast.ImportFrom)]
    imported = {n.asname or n.name: (node.module, n.name) for node in found for n in node.names}
    loaded = {name: (module, name) for name, module in cb._PUBLIC.items()}
    assert imported == loaded | {name: ("cpam_bayes", name) for name in cb._PACKAGES}
    assert sorted(imported) == cb.__all__ == [name for name in dir(cb) if name in imported]


def test_every_verb_is_a_function_after_all_modules_are_imported():
    code = f"""
import importlib, inspect, pkgutil
import cpam_bayes as cb
for module in pkgutil.walk_packages(cb.__path__, "cpam_bayes."):
    if not module.name.endswith("__main__"):
        importlib.import_module(module.name)
print([name for name in {VERBS * 2!r} if not inspect.isfunction(getattr(cb, name))])
"""
    assert subprocess.check_output([sys.executable, "-c", code], text=True, timeout=120) == "[]\n"


@pytest.mark.parametrize(("changes", "question", "said"), REFUSED_PLATES, ids=IDS)
def test_a_question_refuses_a_plate_as_its_command_does(run, plate_file, tmp_path, changes, question, said):
    call, (name, *options) = question[0], question[1].split()
    (tmp_path / "plate.msh").touch()
    path = plate_file(*changes)
    with pytest.raises(ValueError, match=r"plate\.toml") as refused:
        call(path)
    assert said in str(refused.value)
    said = "".join(f"error: {line}\n" for line in str(refused.value).splitlines())
    assert run(name, path, *options, "--quiet") == (2, "", said)


@pytest.mark.parametrize(("call", "said"), REFUSED_CALLS)
def test_an_argument_of_a_wrong_type_or_out_of_range_is_refused(call, said):
    with pytest.raises(ValueError, match=f"^{said}"):
        call()


@pytest.mark.parametrize("name", [name for name in VERBS if name not in ("plates", "builtin_plates")])
def test_an_argument_of_a_wrong_type_is_named_before_any_work(name):
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


def test_a_plate_can_be_given_as_its_content_in_lists_tuples_or_arrays(plate_file):
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


def test_what_is_not_there_is_left_to_python_and_numbers_of_numpy_are_numbers():
    with pytest.raises(AttributeError, match="no attribute 'anneal'"):
        cb.anneal  # noqa: B018
    with pytest.raises(TypeError, match="unexpected keyword argument 'mode'"):
        cb.forward("A1", mode=3)
    with pytest.raises(TypeError, match="missing 1 required positional argument: 'plate'"):
        cb.forward()
    computed = cb.forward("A1", np.int64(1), seed=np.int32(3))
    assert cb.forward(plate="A1", n_modes=1).frequencies == computed.frequencies


def without_seconds(value: Any) -> Any:
    if isinstance(value, dict):
        timed = ("seconds", "per_second")
        return {k: without_seconds(v) for k, v in value.items() if not any(t in k for t in timed)}
    return [without_seconds(v) for v in value] if isinstance(value, list) else value


@pytest.mark.usefixtures("few_causes")
@pytest.mark.parametrize(("call", "argv"), CALLS)
def test_a_call_gives_the_document_warnings_and_status_of_its_command(run, plate_file, call, argv):
    path = plate_file(("resolution_hz = 1.0", "relative_std = 0.0001"))
    result = call(path, seed=2)
    status, out, err = run(argv[0], path, *argv[1:], "--seed", "2", "--json", "--quiet")
    assert err == "".join(f"warning: {warning}\n" for warning in result.warnings)
    assert status == (0 if result.reached_goal else 1)
    assert result.to_dict()["warnings"] == list(result.warnings)
    assert without_seconds(json.loads(out)) == without_seconds(result.to_dict())


def test_a_result_is_one_line_equal_to_itself_alone_and_draws_what_is_asked_for(run):
    point, modes = answered("identify"), cb.forward("A1", 2)
    assert repr(point) == "<PointResult of identify A1: converged, warnings: 1>"
    assert (point.status, point.reached_goal, point.title) == ("converged", True, "A1")
    assert (modes.status, modes.warnings, len(modes.plot().axes)) == ("done", (), 2)
    assert modes.summary() == run("forward", "A1", "--modes", "2", "--quiet")[1]
    again = pickle.loads(pickle.dumps(point))
    assert point == point != again  # arrays have no truth value for comparing results
    assert again.to_dict() == point.to_dict()
    assert list(point.figures()) == ["residuals", "predicted_against_measured", "modes", "plate"]
    assert "residuals" in point.plot().axes[0].get_title("left")
    assert point.plot("predicted_against_measured").axes[0].get_xlabel() == "measured, Hz"
    with pytest.raises(ValueError, match="received 'causes', accepted: residuals predicted_against_measured"):
        point.plot("causes")
    with pytest.raises(ValueError, match="accepted: nothing to draw"):
        cb.plates().plot()
    with pytest.raises(ValueError, match="to_arviz: forward has no draws"):
        modes.to_arviz()


def test_saving_writes_the_files_of_the_command(tmp_path):
    point, out = answered("identify"), tmp_path / "new" / "results"
    point.save(out)
    names = ("predicted_against_measured", "residuals", "modes", "plate")
    files = {f"figures/{name}.{ending}" for name in names for ending in ("png", "svg")}
    files |= {"identify.json", "posterior.nc", "report.html"}
    assert {str(p.relative_to(out)) for p in out.rglob("*") if p.is_file()} == files
    assert json.loads((out / "identify.json").read_text("utf-8")) == point.to_dict()
    with pytest.raises(ValueError, match="a file, accepted: a directory"):
        point.save(out / "identify.json")
    with pytest.raises(ArgumentError, match=r"^directory: received None, accepted: a text or a path"):
        point.save(None)


@pytest.mark.parametrize("name", [pytest.param(name, marks=MARKS.get(name, ())) for name in EXAMPLES])
def test_the_examples_give_what_they_show(name):
    module = import_module(cb._PUBLIC[name])
    (example,) = doctest.DocTestFinder(recurse=False).find(getattr(cb, name), name, module)
    assert doctest.DocTestRunner(optionflags=doctest.NORMALIZE_WHITESPACE).run(example).failed == 0


def test_examples_stand_at_the_verbs_alone():
    modules = map(import_module, sorted(set(cb._PUBLIC.values())))
    found = [example for module in modules for example in doctest.DocTestFinder().find(module)]
    shown = {example.name for example in found if example.examples}
    assert shown == {f"{cb._PUBLIC[name]}.{name}" for name in EXAMPLES}


def test_a_name_with_a_slash_makes_no_path(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    named = tomllib.loads(PLATE + MEASURED) | {"name": "batch 3/plate 7"}
    cb.forward(named, n_modes=2).save(tmp_path / "forward")
    assert str(cb.export(named).path) == "batch_3_plate_7.inp"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["batch_3_plate_7.inp", "forward"]
