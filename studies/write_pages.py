"""Write all generated sections of README.md and docs/ from saved results, without computing anything.

python studies/write_pages.py [NAME ...]
"""

from __future__ import annotations

import argparse
import importlib.util
import json
from collections.abc import Sequence
from pathlib import Path

from validation.reporting import FIGURE, pages, sections_of_figures, with_age, with_sections

HERE = Path(__file__).parent
PROJECT = HERE.parent


def sections(study: str) -> dict[str, str]:
    """Sections that a study writes from its saved results, by name; none if it writes none."""
    spec = importlib.util.spec_from_file_location(f"studies_{study}", HERE / f"{study}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    if not hasattr(module, "sections"):
        return {}
    results = json.loads((HERE / "results" / f"{study}.json").read_text(encoding="utf-8"))
    found: dict[str, str] = module.sections(results)
    return found


def written(page: Path, studies: Sequence[str]) -> str:
    """A page with the sections of these studies, of all figures and of their age rewritten."""
    text = with_sections(page.read_text(encoding="utf-8"), FIGURE, sections_of_figures(PROJECT, page))
    for study in studies:
        if f"<!-- {study}: " in text:
            text = with_sections(text, study, sections(study))
    return with_age(text)


def main(arguments: Sequence[str] | None = None) -> None:
    """Write the sections of the named studies, or of all, and of the figures."""
    names = sorted(path.stem for path in HERE.glob("[0-9]*.py"))
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"all unless given: {', '.join(names)}")
    chosen = parser.parse_args(arguments).names or names
    if unknown := [name for name in chosen if name not in names]:
        parser.error(f"no study is named {', '.join(unknown)}; there are {', '.join(names)}")
    for page in pages(PROJECT):
        text = written(page, chosen)
        if text != page.read_text(encoding="utf-8"):
            page.write_text(text, encoding="utf-8")
            print(page.relative_to(PROJECT))


if __name__ == "__main__":
    main()
