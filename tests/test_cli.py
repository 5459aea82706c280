"""The command line as a user and a script see it: exit status, standard output, standard error."""

import io
import json
import os
import re
import shlex
import signal
import subprocess
import sys
from dataclasses import replace
from functools import partial
from pathlib import Path

import openpyxl
import pytest
from numpy.linalg import LinAlgError

from cpam_bayes import __version__
from cpam_bayes.cli import COMMANDS, main
from cpam_bayes.command import Command
from cpam_bayes.parallel import WorkersLostError
from cpam_bayes.questions import identify, plates
from tests.plate_file import PLATE, refused

PROJECT = Path(__file__).parent.parent
# a single swarm and a few steps suffice here
SHORT = ("--swarms", "1", "--iterations", "8", "--quiet")
EMCEE = "identify A1 --backend emcee"
# endless
IDENTIFY = ("identify", "A1", "--swarms", "1", "--particles", "10000", "--iterations", "100000")
LISTED = "[114, 167, 218, 289, 300, 497]"
SIZES = "length_mm = 300.0\nwidth_mm = 280.0\nthickness_mm = 3.0"
PLACES = [("--out", "taken"), ("--out", "taken/deeper"), ("--xlsx", "none/modes.xlsx"), ("--csv", "a.txt")]
NOT_OF = "not an option of the back end"
REFUSED = [
    *((f"forward A1 --modes {n}", "accepted: a whole number from 1 to 100") for n in ("101", "{long}")),
    *(("forward A1 --solver abaqus", "invalid choice: 'abaqus'"), ("identify A1 --seed -1", "--seed")),
    *(("export A1 --out a.inp", "--to"), ("report A1", "--out"), ("paper 15", "1 to 14"), ("", "COMMAND")),
    *(("guess A1", "guess"), ("identify", "PLATE"), ("identify A1 --iter 3", "unrecognized arguments")),
    ("identify A1 --backend annealing", "invalid choice: 'annealing'"),
    ("identify A1 --particles 2.5", "whole number from 5"),
    *((f"diagnose A1 --scatter={x}", "accepted: a number above 0 and at most 0.5") for x in ("0", "nan")),
    ("sensitivity A1 --levels 0", "'0', accepted: a percentage above 0 and at most 50"),
    ("sensitivity A1 --groups 1", "received '1', accepted: a whole number from 2 to 1000"),
    ("sensitivity A1 --reading 'both ways'", "'both ways', accepted: both relative rms"),
    ("sensitivity A1 --list measured --modes 4", "accepted: with --list model only"),
    ("design C1 --layups [0/?]", "layups: received '[0/?]', accepted: known angles"),
    ("design C1 --edges FFF", "edges: received 'FFF', accepted: four letters"),
    ("design C1 --constants E9", "received E9, accepted: E1_GPa E2_GPa nu12 G12_GPa"),
    ("design C1 --ratios 0", "accepted: a number above 0 and at most 20"),
    ("identify A1 --likelihood absolute", f"--likelihood: {NOT_OF} pso"),
    (f"{EMCEE} --residuals relative", f"--residuals: {NOT_OF} emcee"),
    (f"{EMCEE} --particles 40", f"--particles: {NOT_OF} emcee"),
    *((f"{EMCEE} --store '{p}'", f"store: received {p!r}, accepted: a directory") for p in ("", __file__)),
    ("forward A1 --element brick", "--element: received brick, accepted: with --solver ccx"),
    ("batch A1 --executor ray", "--executor: received 'ray', accepted: processes, serial or dask:"),
    ("batch A1 --workers 0", "argument --workers: received '0', accepted: a whole number from 1"),
    ("batch A1 --workers two", "argument --workers: received 'two'"),
]
RUINOUS = [
    (LISTED, "[114]", "1 frequency for 2 unknowns: the bounds decide"),
    ("E1_GPa = [10.0", "E1_GPa = [70.0", "outside its bounds: E1_GPa = 69 (bounds 70 to 200)"),
    ("[114, 167, 218", "[114, 130, 218", "does not describe these frequencies"),
    ("nu12 = [0.15, 0.4]", "nu12 = { mean = 0.33, sd = 0.02, bounds = [0.15, 0.4] }", ""),
]
SLIPS = [
    ("thickness_mm = 3.0", "thickness_mm = 30.0", "a thickness 10 times too large"),
    (LISTED, "[0.114, 0.167, 0.218, 0.289, 0.3, 0.497]", "frequencies in kHz for Hz"),
    (LISTED, "[716, 1049, 1370, 1816, 1885, 3123]", "frequencies in rad/s for Hz"),
    (SIZES, "length_mm = 0.3\nwidth_mm = 0.28\nthickness_mm = 0.003", "sizes in m for mm"),
]
INTERRUPTED = [
    (IDENTIFY, "up to 100000 iterations", signal.SIGINT),
    (IDENTIFY, "iteration 0 of 100000", signal.SIGINT),
    (("batch", "C1", "C3"), "batch: 2 plates", signal.SIGTERM),
    (("design", "C1", "--modes", "40"), "design C1: 48 specimens", signal.SIGHUP),
]


def listen():
    """Restore the signals that a shell may disable when it runs tests in the background or under nohup."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_DFL)


def start(*argv, code=None, **options):
    """Start the command as a separate process, by default one that listens to signals."""
    how = ("-c", code) if code else ("-m", "cpam_bayes")
    usual = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True, "preexec_fn": listen}
    return subprocess.Popen([sys.executable, *how, *argv], cwd=PROJECT, **usual | options)


def ended(process):
    out, err = process.communicate(timeout=120)
    return process.returncode, out, err


def test_help_and_version_load_neither_numpy_nor_any_other_heavy_library():
    code = """
import sys
sys.argv = ["cpam-bayes", sys.argv[1]]
from cpam_bayes.__main__ import main
status = main()
heavy = {"numpy", "scipy", "pydantic", "rich", "matplotlib"} & set(sys.modules)
sys.exit(f"status {status}, loaded {heavy}" if status or heavy else 0)
"""
    for option, said in (("--help", "usage: cpam-bayes"), ("--version", "cpam-bayes ")):
        status, out, err = ended(start(option, code=code))
        assert (status, err, out.startswith(said)) == (0, "", True)


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_explains_itself(run, command):
    status, out, _ = run(command, "--help")
    assert status == 0
    assert "exit status" in out
    if command != "app":
        assert all(option in out for option in ("--json", "--seed", "--quiet"))
    if command not in ("app", "new"):
        assert re.search("--out FILE +the file to write" if command == "export" else "--out ", out)


def test_plates_lists_every_specimen_with_its_layup(run):
    status, out, err = run("plates")
    assert (status, err, len(json.loads(run("plates", "--json")[1])["plates"])) == (0, "", 17)
    assert re.search(r"^ +D&G +254 x 254 x 3.16 +isotropic +FFFF +aluminium", out, re.M)
    assert re.search(r"C1 +260 x 260 x 3.2 +\[\(0/90\)_8\]_s, 32 plies +FFFF .* 6 +thin", out)


def test_forward_has_as_many_modes_as_were_measured_and_says_how_exactly(run, plate_file):
    status, out, err = run("forward", plate_file(("300, 497", "300")), "--json", "--quiet")
    document = json.loads(out)
    first = document["modes"][0]
    assert (status, err, len(document["modes"]), document["version"]) == (0, "", 5, __version__)
    assert (first["kind"], first["label"]) == ("bending", "(1,1)")
    assert first["frequency_hz"] == pytest.approx(114, rel=0.05)
    assert 0 < document["relative_error_estimate"] < 2e-4
    status, out, err = run("forward", "A1", "--modes", "8", "--verbose")
    assert status == 0
    assert "8 modes" in err
    assert "not in the model; 1.2 kg/m3 would lower the first 6 frequencies by 0." in out
    assert re.search(r"error +about 0\.0\d+ % of a frequency in the worst mode, estimated", out)
    assert re.search(r"1 +11\d\.\d+ +bending +\(1,1\) +114 +[-+]\d", out)
    assert re.search(r"G12 +25.9398 +GPa +eq. \(11\)", out)


def test_identify_as_json_has_the_keys_of_the_contract_and_takes_its_options(run):
    status, out, err = run("identify", "A1", "--json", "--residuals", "relative", "--particles", "7", *SHORT)
    document = json.loads(out)
    assert (status, set(document["constants"])) == (0, {"E1_GPa", "nu12"})
    constant = map(document["constants"]["E1_GPa"].get, ("lower", "upper", "reference"))
    assert (*constant, len(document["frequencies"])) == (10.0, 200.0, 69.0, 6)
    for row in document["frequencies"]:
        ratio = row["predicted_hz"] / row["measured_hz"]
        percent = pytest.approx(100 * (ratio - 1), abs=1e-9)
        assert (row["kind"], row["residual_percent"]) == ("bending", percent)
    assert {"D11", "D26", "Ex_GPa"} <= set(document["laminate"])
    assert 0 < document["forward_solves"] <= 7 * 9
    assert document["seconds"] > 0
    assert document["relative_error_estimate"] < 1e-3
    assert (document["residuals"], document["status"], document["seed"]) == ("relative", "budget", 0)
    assert "budget" in document["message"]
    assert document["warnings"] != []
    assert all(f"warning: {warning}" in err for warning in document["warnings"])


def first_sentences(out):
    return " ".join(out.split("\n\n")[0].split())


@pytest.mark.parametrize(("old", "new", "first"), RUINOUS)
def test_what_ruins_an_answer_is_its_first_line_and_the_rest_a_warning(run, plate_file, old, new, first):
    path = plate_file((old, new))
    status, out, err = run("identify", path, *SHORT)
    assert status == 0
    assert first in first_sentences(out)
    assert "warning: " in err
    _, out, by_eq_7 = run("identify", path, "--json", "--residuals", "absolute", *SHORT)
    assert (json.loads(out)["constants"]["E1_GPa"]["sd"] is None) == (new == "[114]")
    said = "only the bounds of nu12"
    assert (said in by_eq_7) == ("mean" in new)
    assert said not in err


@pytest.mark.parametrize(("old", "new", "cure"), SLIPS)
def test_a_slip_of_units_leads_forward_and_no_constants_are_sought(run, plate_file, old, new, cure):
    path = plate_file((old, new))
    status, out, err = run("forward", path, "--quiet")
    assert status == 0
    for said in (err, first_sentences(out)):
        assert re.search(rf"times the measured one.*{cure}", said, re.S)
    for name, *options in (("identify",), ("identify", "--backend", "emcee"), ("diagnose",)):
        refused(run(name, path, "--quiet", *options), "frequencies_hz", "come near", cure)


@pytest.fixture
def of_two(plate_file, tmp_path):
    rows = "mode;left;right\n1;114;113\n2;167;166\n3;218;217\n4;289;287\n"
    (tmp_path / "modes.csv").write_text(rows, encoding="utf-8")
    return plate_file(text=PLATE + '\n[measurement]\ntable = "modes.csv"\nresolution_hz = 1.0\n')


def at_terminal(monkeypatch, lines, stdout=True):
    monkeypatch.setattr(sys, "stdin", io.StringIO(lines))
    for stream, is_one in ((sys.stdin, True), (sys.stdout, stdout)):
        monkeypatch.setattr(stream, "isatty", lambda is_one=is_one: is_one, raising=False)


def test_a_terminal_is_asked_once_which_column_has_the_frequencies(run, of_two, monkeypatch):
    at_terminal(monkeypatch, "3\n2\nnot asked for\n")
    status, out, err = run("identify", of_two, *SHORT)
    assert (status, sys.stdin.read()) == (0, "not asked for\n"), err
    kept = f'To keep this, add to {of_two}\n  [measurement.columns]\n  hz = "right"\n'
    for said in ("  1  left\n  2  right\n", "received '3', accepted: 1 to 2", kept):
        assert said in err
    with open(of_two, "a", encoding="utf-8") as file:
        file.write('[measurement.columns]\nhz = "right"\n')
    at_terminal(monkeypatch, "")
    assert run("identify", of_two, *SHORT)[:2] == (0, out)


# an empty line, no line, output to a file, and a script
@pytest.mark.parametrize("typed", [("\n", True), ("", True), ("2\n", False), ("2\n", True, "--json")])
def test_without_an_answer_an_ambiguous_table_is_refused(run, of_two, monkeypatch, typed):
    lines, stdout, *options = typed
    at_terminal(monkeypatch, lines, stdout)
    status, out, err = run("identify", of_two, *SHORT, *options)
    assert (status, out) == (2, "")
    assert 'name it in [measurement.columns]: hz = "HEAD"' in err.splitlines()[-1]


@pytest.mark.parametrize(("line", "fragment"), REFUSED)
def test_a_bad_option_is_refused_with_what_is_accepted(run, line, fragment):
    refused(run(*shlex.split(line.format(long="9" * 10**5))), fragment)


@pytest.mark.parametrize(("option", "place"), PLACES)
def test_what_cannot_be_written_to_is_refused_before_the_work(run, tmp_path, option, place, monkeypatch):
    def never(*args, **kwargs):
        raise AssertionError("the work has begun")

    monkeypatch.setattr("cpam_bayes.questions.forward.converged_model", never)
    monkeypatch.chdir(tmp_path)
    Path("taken").write_text("mine")
    refused(run("forward", "A1", option, place), f"error: {option}", place.partition("/")[0])
    assert Path("taken").read_text() == "mine"


@pytest.mark.parametrize("error", [OSError(28, "No space left on device"), ValueError("drawn in vain")])
def test_an_answer_that_cannot_be_saved_is_shown_all_the_same(run, tmp_path, monkeypatch, error):
    def full(*args):
        raise error

    monkeypatch.setattr("cpam_bayes.render.figures.save_figures", full)
    out = tmp_path / "out"
    status, text, err = run("forward", "A1", "--modes", "1", "--json", "--quiet", "--out", out)
    assert (status, len(json.loads(text)["modes"])) == (1, 1)
    assert str(error.args[-1]) in err
    assert [path.name for path in out.iterdir()] == ["forward.json"]  # results without undrawable figures


@pytest.mark.parametrize("buffered", ["", "1"])
@pytest.mark.parametrize("argv", [("plates",), ("--version",), ("--help",), ("forward", "--help")])
def test_an_answer_that_a_full_disk_does_not_take_is_said_to_be_lost(buffered, argv):
    with open("/dev/full", "w") as full:
        env = {**os.environ, "PYTHONUNBUFFERED": buffered}
        status, _, err = ended(start(*argv, stdout=full, env=env))
    said = "error: standard output: No space left on device; the answer was not written\n"
    assert (status, err) == (1, said)


@pytest.mark.parametrize("finished", [True, False, None])
def test_an_interrupted_run_says_how_to_go_on_or_could(finished, tmp_path, monkeypatch, capsys):
    def interrupted(*args, **options):
        raise KeyboardInterrupt

    monkeypatch.setattr(identify, "COMMAND", replace(identify.COMMAND, verb=interrupted))
    if finished:
        (tmp_path / "round_0000.h5").touch()
    with pytest.raises(KeyboardInterrupt):
        main([*EMCEE.split(), *([] if finished is None else ["--store", str(tmp_path)])])
    kept = f"what was finished is kept in {tmp_path}: the same command resumes there\n"
    nothing = "nothing was kept; with --store DIR the same command would resume\n"
    assert capsys.readouterr().err == {True: kept, False: "", None: nothing}[finished]


@pytest.mark.parametrize(("argv", "line", "number"), INTERRUPTED)
def test_an_interrupted_run_ends_with_130_one_line_and_no_files(argv, line, number, tmp_path):
    out = tmp_path / "out"
    process = start(*argv, "--out", str(out))
    assert any(line in said for said in process.stderr)
    assert [path.name.startswith(".cpam-bayes-") for path in out.iterdir()] == [True]
    process.send_signal(number)
    status, rest, err = ended(process)
    assert (status, rest, err.splitlines()[-1]) == (130, "", "cpam-bayes: interrupted")
    assert not out.exists()
    assert "Traceback" not in err


def test_a_signal_that_the_shell_said_to_ignore_is_ignored():
    ignoring = partial(signal.signal, signal.SIGHUP, signal.SIG_IGN)
    process = start("identify", "A1", "--swarms", "1", preexec_fn=ignoring)
    assert any("iteration 0" in said for said in process.stderr)
    process.send_signal(signal.SIGHUP)
    status, out, _ = ended(process)
    assert status == 0
    assert "E1" in out


# While libraries load; and inside exec of a text, as when a module with dataclasses is imported.
WHILE_LOADING = """
import os, signal, sys

class Interrupt:
    def find_spec(self, name, path=None, target=None):
        if name == "numpy.linalg":
            os.kill(os.getpid(), signal.SIGINT)

sys.meta_path.insert(0, Interrupt())
from cpam_bayes.__main__ import main
sys.exit(main())
"""
INSIDE_EXEC = """
import cpam_bayes.cli, cpam_bayes.__main__ as run
cpam_bayes.cli.prepare = lambda argv: lambda: exec('raise KeyboardInterrupt')
print(run.main())
"""


@pytest.mark.parametrize(("code", "status", "out"), [(WHILE_LOADING, 130, ""), (INSIDE_EXEC, 0, "130\n")])
def test_an_interruption_elsewhere_ends_with_130_too(code, status, out):
    assert ended(start("identify", "A1", code=code)) == (status, out, "cpam-bayes: interrupted\n")


def test_a_reader_that_leaves_early_is_no_error():
    read, write = os.pipe()
    os.close(read)
    status, _, err = ended(start("plates", stdout=write))
    os.close(write)
    assert (status, err) == (0, "")


def test_the_command_gives_each_library_one_thread_unless_told_otherwise():
    code = "import os, cpam_bayes.__main__; print(os.environ['OPENBLAS_NUM_THREADS'])"
    own = {k: v for k, v in os.environ.items() if k != "OPENBLAS_NUM_THREADS"}
    for given, expected in (({}, "1"), ({"OPENBLAS_NUM_THREADS": "3"}, "3")):
        assert ended(start(code=code, env={**own, **given}))[1].strip() == expected


def test_what_is_no_fault_of_the_input_ends_with_one_message_and_1_or_is_an_error(run, monkeypatch):
    def ended_by(error):
        def failing():
            raise error

        monkeypatch.setattr(plates, "COMMAND", Command(failing, watched=False, seeded=False))
        return run("plates")

    unsolved = "error: a plate model cannot be solved, please report it: Matrix is singular\n"
    assert ended_by(LinAlgError("Matrix is singular")) == (1, "", unsolved)
    lost = WorkersLostError("four workers died at item 3")
    assert ended_by(lost) == (1, "", "error: four workers died at item 3\n")
    with pytest.raises(KeyError):
        ended_by(KeyError("A1"))


def test_tables_are_written_as_csv_and_workbook(run, tmp_path):
    csv, xlsx = tmp_path / "modes.csv", tmp_path / "modes.xlsx"
    status, out, _ = run("forward", "A1", "--modes", "3", "--quiet", "--json", "--csv", csv, "--xlsx", xlsx)
    assert status == 0
    meant = [mode["frequency_hz"] for mode in json.loads(out)["modes"]]
    head, *rows = (line.split(",") for line in csv.read_text(encoding="utf-8-sig").splitlines())
    assert [float(row[head.index("frequency_hz")]) for row in rows] == meant
    head, *rows = openpyxl.load_workbook(xlsx).worksheets[0].values
    # a workbook keeps 15 digits
    assert [row[head.index("frequency_hz")] for row in rows] == pytest.approx(meant, rel=1e-14)
