"""Run notebooks and save them with their results.

python notebooks/execute.py [NAME ...]

Executed in this folder, cell by cell, in a kernel of this environment. Times and versions are not kept, so
a notebook changes only where its results do.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import nbformat
from nbclient import NotebookClient

FOLDER = Path(__file__).parent
# Time limit for each cell, s.
TIMEOUT = 600


def executed(path: Path) -> nbformat.NotebookNode:
    """A notebook with the results of all its cells, computed afresh.

    Raises ``nbclient.exceptions.CellExecutionError`` where a cell fails.
    """
    notebook = nbformat.read(path, as_version=4)
    client = NotebookClient(
        notebook, timeout=TIMEOUT, record_timing=False, resources={"metadata": {"path": str(path.parent)}}
    )
    client.execute()
    notebook.metadata = {"kernelspec": {"display_name": "Python 3", "language": "python", "name": "python3"}}
    return notebook


def main() -> None:
    """Execute the notebooks that are named, all by default."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    names = sorted(path.stem for path in FOLDER.glob("*.ipynb"))
    parser.add_argument("names", nargs="*", choices=[*names, []], metavar="NAME", help=", ".join(names))
    for name in parser.parse_args().names or names:
        path = FOLDER / f"{name}.ipynb"
        nbformat.write(executed(path), path)
        print(path.name)


if __name__ == "__main__":
    main()
