"""Pictures of the report of C1 for the tutorial, as a screen and as a phone show it.

    python docs/build/screenshots.py [PAGE]

computes the report with seed 0, or takes the page of one that was computed, and needs the program chromium.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path
from typing import Final

from PIL import Image

import cpam_bayes as cb

PROJECT: Final = Path(__file__).parents[2]
PICTURES: Final = PROJECT / "docs" / "pictures"
# Name of the picture -> width and height of the window, CSS pixels.
WINDOWS: Final = {"report_C1_wide": (1100, 1500), "report_C1_phone": (390, 1500)}
# Colours of a palette that is enough for text, marks and thin lines.
_COLOURS: Final = 128


def photograph(page: Path, directory: Path) -> list[Path]:
    """Write one picture a window, and return where they are."""
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


def main() -> None:
    """Compute the report unless its page is given, and write the pictures."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("page", nargs="?", type=Path, help="report.html of C1 (default: computed)")
    page = parser.parse_args().page
    with tempfile.TemporaryDirectory() as directory:
        if page is None:
            cb.report("C1", seed=0).save(directory)
            page = Path(directory) / "report.html"
        for path in photograph(page, PICTURES):
            print(path.relative_to(PROJECT))


if __name__ == "__main__":
    main()
