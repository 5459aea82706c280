"""Nothing that Windows lacks is needed: the commands run where its names are taken away."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from tests.plate_file import MEASURED, PLATE

# Worker processes import the script too, so that they lack the same.
SCRIPT = """
import os, signal, sys

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


@pytest.mark.parametrize(
    "arguments",
    [
        ("--version",),
        ("identify", "panel.toml", "--json", "--out", "answer"),
        pytest.param(("batch", "panel.toml", "other.toml", "--out", "answers"), marks=pytest.mark.slow),
    ],
    ids=("version", "identify", "batch"),
)
def test_commands_run_without_the_names_that_windows_lacks(
    tmp_path: Path, arguments: tuple[str, ...]
) -> None:
    (tmp_path / "run.py").write_text(SCRIPT, encoding="utf-8")
    for name in ("panel", "other"):
        (tmp_path / f"{name}.toml").write_text(PLATE + MEASURED, encoding="utf-8")
    left = tmp_path / ".cpam-bayes-00000000-1-left"  # what a killed process left is looked at
    left.write_bytes(b"")
    command = [sys.executable, "run.py", *arguments]
    ended = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert (ended.returncode, "Traceback" in ended.stderr) == (0, False), ended.stderr
    assert ended.stdout
