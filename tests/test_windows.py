"""The commands run and end without the names that Windows lacks."""

import os
import signal
import subprocess
import sys
from typing import Any

import pytest

from tests.plate_file import MEASURED, PLATE

# Worker processes import the script too, so that they lack the same names.
SCRIPT = """
import os, signal, sys
from multiprocessing import popen_fork, resource_tracker

popen_fork.Popen.kill = lambda process: process._send_signal(9)  # Windows ends a process by no signal

if __name__ == "__main__":
    resource_tracker.ensure_running()  # Windows has none; only a mask keeps Ctrl-C from one that starts

for module in ("fcntl", "resource", "grp", "pwd", "termios", "pty", "tty"):
    sys.modules[module] = None
for name in ("SIGHUP", "SIGKILL", "SIGALRM", "SIGUSR1", "pthread_sigmask", "sigwait", "alarm"):
    delattr(signal, name)
for name in ("geteuid", "getuid", "getgid", "fork", "killpg", "setsid", "getpgid", "sched_getaffinity",
             "O_NONBLOCK", "O_CLOEXEC", "O_DIRECTORY", "O_NOFOLLOW", "getloadavg", "sysconf", "statvfs",
             "mkfifo", "chown"):
    delattr(os, name)
kill = os.kill

def kill_there(process, number):
    assert number != 0, "signal 0 is Ctrl-C on Windows"
    kill(process, number)

os.kill = kill_there

if __name__ == "__main__":
    from cpam_bayes.__main__ import main
    raise SystemExit(main())
"""
WORKERS = ("--workers", "2")
MANY = ("batch", "panel.toml", "C1", "C3", *WORKERS)
LONG = ("--swarms", "1", "--iterations", "100000", "--particles", "10000")


@pytest.fixture
def folder(tmp_path):
    coin = "frequencies_hz = [113, 165, 217, 286, 299, 493]\n"
    files = {"run.py": SCRIPT, "coin.toml": coin, ".cpam-bayes-00000000-1-left": ""}  # of a killed process
    for name, text in (files | dict.fromkeys(("panel.toml", "other.toml"), PLATE + MEASURED)).items():
        (tmp_path / name).write_text(text, encoding="utf-8")
    return tmp_path


def slow(*arguments: object) -> Any:
    return pytest.param(*arguments, marks=pytest.mark.slow)


RUNS = [
    *(("--version",), ("identify", "panel.toml", "--json", "--out", "answer")),
    slow(("batch", "panel.toml", "other.toml", "--out", "answers", *WORKERS)),
    slow(("prove", "panel.toml", "coin.toml", "--out", "answer")),
]


@pytest.mark.parametrize("arguments", RUNS)
def test_commands_run_without_the_names_that_windows_lacks(folder, arguments):
    command = [sys.executable, "run.py", *arguments]
    ended = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    assert (ended.returncode, "Traceback" in ended.stderr) == (0, False), ended.stderr
    assert ended.stdout


@pytest.mark.parametrize(
    ("arguments", "line"), [(("identify", "panel.toml", *LONG), "iter"), slow(MANY, "batch: 3")]
)
def test_ctrl_c_ends_a_run_without_the_names_that_windows_lacks(folder, arguments, line):
    process = subprocess.Popen(
        [sys.executable, "run.py", *arguments, "--out", "answer"], cwd=folder, text=True,
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, start_new_session=True,
        # a shell that runs the tests in the background makes them ignore interrupts
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )  # fmt: skip
    assert any(line in said for said in process.stderr)
    os.killpg(process.pid, signal.SIGINT)  # a console sends Ctrl-C to workers too
    out, err = process.communicate(timeout=60)
    assert (process.returncode, out, err.splitlines()[-1]) == (130, "", "cpam-bayes: interrupted")
    assert not (folder / "answer").exists()
    assert "Traceback" not in err
