"""A fingerprint of the sources that a result depends on: the hash of a module and of all it imports.

Unlike a version, it tells results of different states of the code apart. Presentation (`cpam_bayes.render`
and what is built on it), docstrings, comment lines and blank lines do not enter it.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import cache
from pathlib import Path
from typing import Final

_PACKAGE: Final = Path(__file__).parent
_DIGITS: Final = 12
# Imports at any indentation; in parentheses they may span several lines.
_FROM: Final = re.compile(r"^[ \t]*from (cpam_bayes[\w.]*) import (\([^)]*\)|[^\n]*)", re.MULTILINE)
_IMPORT: Final = re.compile(r"^[ \t]*import (cpam_bayes[\w.]*)", re.MULTILINE)
# Modules of presentation and of the command line.
_APPEARANCE: Final = frozenset({"render", "result", "command", "cli", "__main__", "__init__"})

# Docstrings, comments and blank lines, as whole lines; other multi-line strings are kept as they are.
_WORDS: Final = re.compile(
    r'''^[ \t]*"""(?:.|\n)*?"""[ \t]*(?:\n|\Z)|^[ \t]*(?:#[^\n]*)?\n|((?<!')"""(?:.|\n)*?""")''', re.MULTILINE
)


def text_of(file: Path) -> str:
    """The text of a source file."""
    return file.read_text(encoding="utf-8")


@cache
def fingerprint(module: str, read: Callable[[Path], str] = text_of) -> str:
    """The first twelve hexadecimal digits of a SHA-256 over the sources of a module and of all it imports.

    module : full name in this package. read : gives the text of a source file
    """
    return _hash(sources_of(_imports_of(_file(module)), [_file(module)]), read)


def fingerprint_of_script(
    script: Path, public: Mapping[str, str], read: Callable[[Path], str] = text_of
) -> str:
    """Fingerprint of what a script outside the package imports from it, without the script itself.

    public : public name of the package -> the module that holds it; a script calls them as cb.NAME
    read : gives the text of a source file
    """
    called = re.findall(r"\bcb\.(\w+)", text_of(script))
    modules = [*_imports_of(script), *(public[name] for name in called if name in public)]
    return _hash(sources_of(modules, []), read)


def sources_of(modules: Iterable[str], start: Iterable[Path | None]) -> list[Path]:
    """Files of modules and of everything they import, sorted by name."""
    found = {file for file in start if file is not None}
    waiting = list(modules)
    while waiting:
        file = _file(waiting.pop())
        if file is None or file in found or _room(file) in _APPEARANCE:
            continue
        found.add(file)
        waiting += _imports_of(file)
    return sorted(found)


def _room(file: Path) -> str:
    """The folder or file of the package that holds a file."""
    return file.relative_to(_PACKAGE).parts[0].removesuffix(".py")


def _hash(files: Iterable[Path], read: Callable[[Path], str]) -> str:
    digest = hashlib.sha256()
    for file in files:
        digest.update(file.relative_to(_PACKAGE).as_posix().encode())
        digest.update(without_words(read(file)).encode())
    return digest.hexdigest()[:_DIGITS]


def without_words(source: str) -> str:
    """The text of a module without its docstrings, comment lines and blank lines."""
    return _WORDS.sub(lambda found: found[1] or "", source)


def _imports_of(file: Path | None) -> Iterator[str]:
    """Full names of this package's modules, and of names in them, that a file imports."""
    if file is None:
        return
    text = file.read_text(encoding="utf-8")
    for found in _FROM.finditer(text):
        yield found[1]
        yield from (f"{found[1]}.{name}" for name in re.findall(r"(?:^|[,(]\s*)(\w+)", found[2]))
    yield from _IMPORT.findall(text)


def _file(module: str) -> Path | None:
    """The file of a module, None if there is no such module."""
    place = _PACKAGE.joinpath(*module.split(".")[1:])
    for file in (place.with_suffix(".py"), place / "__init__.py"):
        if place != _PACKAGE and file.is_file():
            return file
    return None
