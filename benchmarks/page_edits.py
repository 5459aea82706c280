"""Seconds from an edit on the page to its live answer, over HTTP, and the memory of server and workers.

python -m benchmarks.page_edits [--plate PLATE] [--edits N] [--more N]

Needs the extras `app` and `test`. Edits change the first frequency and the width of the plate in turn.
"""

from __future__ import annotations

import argparse
import os
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import httpx

from cpam_bayes.plate import read_plate

ROOT = Path(__file__).parents[1]
# Seconds after which an edit counts as unanswered, and pause before the next one.
_PATIENCE, _REST = 30.0, 0.3


class Page:
    """A visit to a plate file on a server of its own."""

    def __init__(self, client: httpx.Client, plate: str) -> None:
        self.client = client
        self.visit = client.post("/open", json={"file": plate}).json()["go"]
        self.answer = ""
        self.wait(0)

    def edit(self, **change: Any) -> int:
        """Change the plate file and return the page's version after it."""
        answer = self.client.post(f"{self.visit}/edit", json={"structure": -1, **change})
        return int(answer.raise_for_status().json().get("version", 0))

    def wait(self, seen: int) -> None:
        """Return when there is a new live answer."""
        end = time.monotonic() + _PATIENCE
        while time.monotonic() < end:
            news = self.client.get(f"{self.visit}/news?seen={seen}&structure=-1").json()
            seen, answer = news["version"], news["parts"].get("answer", "")
            if "live" in answer and answer != self.answer:
                self.answer = answer
                return
        raise TimeoutError(f"no live answer within {_PATIENCE:g} s")

    def timed(self, n: int, change: Callable[[int], dict[str, Any]]) -> list[float]:
        """Seconds of each of n edits."""
        seconds = []
        for i in range(n):
            begin = time.perf_counter()
            self.wait(self.edit(**change(i)))
            seconds.append(time.perf_counter() - begin)
            time.sleep(_REST)
        return seconds


def resident_mib(parent: int) -> float:
    """Memory of a process and its descendants, MiB."""
    lines = subprocess.run(["ps", "-e", "-o", "pid=,ppid=,rss="], capture_output=True, text=True, check=True)
    rows = [tuple(map(int, line.split())) for line in lines.stdout.splitlines()]
    family, grown = {parent}, True
    while grown:
        before = len(family)
        family |= {pid for pid, of, _ in rows if of in family}
        grown = len(family) > before
    return sum(rss for pid, _, rss in rows if pid in family) / 1024


@contextmanager
def served(plate: Path) -> Iterator[tuple[Page, int]]:
    """Open a copy of a plate file in a server of its own; yields the page and the server's process id."""
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1"}
    with tempfile.TemporaryDirectory() as folder:
        shutil.copy(plate, folder)
        command = [sys.executable, "-m", "cpam_bayes", "app", folder, "--no-browser", "--port", "0"]
        with subprocess.Popen(command, stdout=subprocess.PIPE, env=environment, text=True) as server:
            assert server.stdout is not None
            try:
                address = server.stdout.readline().split()[-1]
                base = address.partition("/?")[0]
                with httpx.Client(base_url=base, headers={"Origin": base}, timeout=60.0) as client:
                    client.get(address, follow_redirects=True).raise_for_status()
                    yield Page(client, plate.name), server.pid
            finally:
                server.terminate()


def main() -> None:
    """Edit a plate file and print median times and the memory."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--plate", type=Path, default=ROOT / "examples" / "panel.toml")
    parser.add_argument("--edits", type=int, default=20, help="of the frequency, and of the width")
    parser.add_argument("--more", type=int, default=0, help="edits without waiting, for the memory")
    options = parser.parse_args()
    known = read_plate(options.plate)
    assert known.measurement is not None
    first, width = float(known.measurement.frequencies[0]), 1e3 * known.plate.width

    def of_frequency(i: int) -> dict[str, Any]:
        return {"do": "row", "index": 0, "value": f"{first + 0.01 * (i + 1):.2f}"}

    def of_width(i: int) -> dict[str, Any]:
        return {"do": "set", "key": "plate.width_mm", "value": f"{width + 0.1 * (i + 1):.1f}"}

    with served(options.plate) as (page, server):
        for what, change in (("frequency", of_frequency), ("width", of_width)):
            seconds = page.timed(options.edits, change)
            print(f"{what}: median {statistics.median(seconds):.2f} s, largest {max(seconds):.2f} s")
        print(f"memory: {resident_mib(server):.0f} MiB")
        for i in range(options.more):
            page.edit(**of_frequency(i % 100))
        if options.more:
            print(f"memory after {options.more} edits more: {resident_mib(server):.0f} MiB")


if __name__ == "__main__":
    main()
