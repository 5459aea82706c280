"""Drafts: nobody's are swept, a running process's never."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from cpam_bayes.storage.drafts import draft_directory, draft_file, sweep

KILLED = """
import os, signal, sys
from pathlib import Path
from cpam_bayes.storage import draft_directory, draft_file
place = Path(sys.argv[1])
with draft_directory(place) as directory, draft_file(place) as (path, file):
    (directory / "figures").mkdir()
    (directory / "figures" / "one.png").write_text("half")
    os.kill(os.getpid(), signal.SIGKILL)
"""


def kill_a_writer(place: Path) -> list[Path]:
    """Drafts that a killed process left."""
    before = set(place.iterdir())
    done = subprocess.run([sys.executable, "-c", KILLED, str(place)], check=False, timeout=60)
    assert done.returncode == -9
    return sorted(set(place.iterdir()) - before)


def test_what_a_killed_process_left_is_swept_and_nothing_else(tmp_path: Path) -> None:
    with draft_directory(tmp_path) as own, draft_file(tmp_path) as (mine, _):
        (tmp_path / "results.json").write_text("{}")
        (tmp_path / ".cpam-bayes.toml").write_text("")
        left = kill_a_writer(tmp_path)
        assert len(left) == 2
        sweep(tmp_path)
        assert set(tmp_path.iterdir()) == {
            own,
            mine,
            *map(tmp_path.joinpath, ("results.json", ".cpam-bayes.toml")),
        }
    assert sorted(p.name for p in tmp_path.iterdir()) == [".cpam-bayes.toml", "results.json"]


def test_the_next_draft_in_a_directory_sweeps_it(tmp_path: Path) -> None:
    left = kill_a_writer(tmp_path)
    with draft_file(tmp_path):
        assert not any(path.exists() for path in left)


@pytest.mark.parametrize(
    "name", [".cpam-bayes-00000000-1-x", ".cpam-bayes-x8fs7d"], ids=["other machine", "nobody"]
)
def test_drafts_of_unknown_processes_are_swept_after_a_day(tmp_path: Path, name: str) -> None:
    draft = tmp_path / name
    draft.mkdir()
    sweep(tmp_path)
    assert draft.exists()
    written = draft.stat().st_mtime - 86_401.0
    os.utime(draft, (written, written))
    sweep(tmp_path)
    assert not draft.exists()


def test_a_link_that_looks_like_a_draft_is_not_followed(tmp_path: Path) -> None:
    kept = tmp_path / "kept"
    kept.mkdir()
    (kept / "file").write_text("mine")
    (left, _) = kill_a_writer(tmp_path)
    link = tmp_path / f"{left.name}link"
    link.symlink_to(kept)
    sweep(tmp_path)
    assert [p.name for p in tmp_path.iterdir()] == ["kept"]
    assert (kept / "file").read_text() == "mine"


def test_a_directory_that_is_not_there_has_nothing_to_sweep(tmp_path: Path) -> None:
    sweep(tmp_path / "nowhere")
