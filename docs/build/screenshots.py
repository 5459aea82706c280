"""Screenshots of the report of C1 for the tutorial, and of the app's page.

    python docs/build/screenshots.py [PAGE]
    python docs/build/screenshots.py --app RECORDING

computes the report with seed 0, or takes the page of an existing report, and needs the program chromium.
With `--app` the pictures are of `cpam-bayes app`: its example, and a recorded hit with one pick left out.
"""

from __future__ import annotations

import argparse
import base64
import signal
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Final

from PIL import Image

import cpam_bayes as cb

PROJECT: Final = Path(__file__).parents[2]
PICTURES: Final = PROJECT / "docs" / "pictures"
# Name of the picture -> width and height of the window, CSS pixels.
WINDOWS: Final = {"report_C1_wide": (1100, 1500)}
# Number of colours in the palette: enough for text, marks and thin lines.
_COLOURS: Final = 128


def photograph(page: Path, directory: Path) -> list[Path]:
    """Write one picture per window, and return their paths."""
    sys.path.insert(0, str(PROJECT))
    from tests.browser import open_browser

    written = []
    with open_browser() as browser:
        for name, (width, height) in WINDOWS.items():
            path = directory / f"{name}.png"
            browser.show(page, width, height)
            browser.picture(path, whole=False)
            with Image.open(path) as taken:
                few = taken.convert("RGB").quantize(_COLOURS)
            few.save(path, optimize=True)
            written.append(path)
    return written


def photograph_app(recording: Path, directory: Path) -> list[Path]:
    """Write the pictures of the app: the claim of its example, and the picks of a recording."""
    sys.path.insert(0, str(PROJECT))
    from tests.browser import open_browser

    wide, picks = directory / "app_wide.png", directory / "app_picks.png"
    content = base64.b64encode(recording.read_bytes()).decode()
    with tempfile.TemporaryDirectory() as folder, open_browser() as browser:
        command = (sys.executable, "-m", "cpam_bayes", "app", folder, "--port", "0", "--no-browser")
        server = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        assert server.stdout is not None
        browser.visit(server.stdout.readline().strip(), 1280, 1000)
        browser.value("document.querySelector('[data-open=example]').click()")
        browser.until("!!document.querySelector('#answer .headline')")
        browser.until("!!document.querySelector('#diagnosis .headline')")
        browser.picture(wide, whole=False)
        browser.value(
            f"drop(new File([Uint8Array.from(atob('{content}'), (c) => c.charCodeAt(0))], 'tap.wav')) && 1"
        )
        browser.until("!!document.querySelector('.spectrum')")
        browser.value("document.querySelector('[data-leave=\"4\"]').click()")
        browser.until("!!document.querySelector('tr.out')")
        browser.until("document.querySelectorAll('[id^=model]:not(:empty)').length > 4")
        browser.value("document.querySelector('#spectrum').scrollIntoView()")
        browser.value("scrollBy(0, -130)")
        browser.picture(picks, whole=False)
        server.send_signal(signal.SIGINT)
        server.wait()
    for path in (wide, picks):
        with Image.open(path) as taken:
            few = taken.convert("RGB").quantize(_COLOURS)
        few.save(path, optimize=True)
    return [wide, picks]


def main() -> None:
    """Compute the report unless its page is given, and write the pictures."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("page", nargs="?", type=Path, help="report.html of C1 (default: computed)")
    parser.add_argument("--app", type=Path, help="a recorded hit (.wav) of the panel: pictures of the page")
    args = parser.parse_args()
    if args.app is not None:
        for path in photograph_app(args.app, PICTURES):
            print(path.relative_to(PROJECT))
        return
    page = args.page
    with tempfile.TemporaryDirectory() as directory:
        if page is None:
            cb.report("C1", seed=0).save(directory)
            page = Path(directory) / "report.html"
        for path in photograph(page, PICTURES):
            print(path.relative_to(PROJECT))


if __name__ == "__main__":
    main()
