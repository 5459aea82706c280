"""All figures, or some, from saved results, each with its caption file.

python figures/draw.py [NAME ...] [--out DIR] [--results DIR] [--format png|pdf|svg]
"""

from __future__ import annotations

import argparse
import importlib.util
from collections.abc import Sequence
from pathlib import Path

from journal import FIGURES, Drawing, add_options, draw_all

NOT_FIGURES = ("draw", "journal")
NAMES = sorted(path.stem for path in FIGURES.glob("*.py") if path.stem not in NOT_FIGURES)


def drawing(name: str) -> Drawing:
    """The drawing that a script defines."""
    spec = importlib.util.spec_from_file_location(f"figures_{name}", FIGURES / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    found: Drawing = module.draw
    return found


def main(arguments: Sequence[str] | None = None) -> None:
    """Draw the figures named on the command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"all unless given: {', '.join(NAMES)}")
    add_options(parser)
    options = parser.parse_args(arguments)
    named = [Path(name).stem for name in options.names] or NAMES
    unknown = [name for name in named if name not in NAMES]
    if unknown:
        parser.error(f"no figure is named {', '.join(unknown)}; there are {', '.join(NAMES)}")
    draw_all([drawing(name) for name in named], options)


if __name__ == "__main__":
    main()
