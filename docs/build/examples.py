"""Run the examples of the documentation, compare them with the pages, and rewrite their outputs.

    python docs/build/examples.py docs/tutorial.md ...

runs the examples of the pages and writes their outputs and pictures into them. The tests run the same
examples and compare. The examples of a page run from top to bottom, in a directory of their own:

- a block with ``title="NAME"`` is written to a file; with ``title="added to NAME"`` it is appended to one;
- the ``python`` blocks of a page share a session; an expression that ends in ``# -> value`` has that value;
- a line ``$ COMMAND`` of a ``console`` block runs in a shell, and what follows is what it prints;
  a command that ends with `` &`` runs until the page ends;
- ``<!-- show: TITLE | TITLE -->`` before such a block keeps the named parts of a screen and puts "..."
  for others;
- ``<!-- picture: FILE -->`` before an image names the file of the examples that it shows.
"""

from __future__ import annotations

import ast
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import textwrap
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

_BLOCK = re.compile(
    r"(?:^<!-- show: (?P<show>[^\n]*) -->\n)?^```(?P<language>\w+)(?P<info>[^\n]*)\n(?P<text>.*?)^```$"
    r"|^<!-- picture: (?P<source>\S+) -->\n!\[[^\]]*\]\((?P<picture>[^)]+)\)",
    re.MULTILINE | re.DOTALL,
)
_TITLE = re.compile(r'title="(?P<added>added to )?(?P<name>[^"]+)"')
# Durations, and rates per second, differ from run to run.
_TIMES = re.compile(r"\d[\d.]*(?= s\b)|\d+(?= effective samples a second)|\d+(?= in all$)")
_NUMBER = re.compile(r"(?<![\w.])\d+(?:\.\d+)?(?:e[+-]?\d+)?")
_SPREAD = re.compile(r" \+- (\d+(?:\.\d+)?)")
_OTHERS = "..."
_WIDTH = 100


class ExampleError(AssertionError):
    """An example that fails, or whose output differs from the page."""


@dataclass
class _Session:
    directory: Path
    page: Path
    names: dict[str, Any]
    background: list[subprocess.Popen[bytes]]


def check(page: Path, directory: Path) -> int:
    """Run the examples of a page in a directory, compare them with the page, and return how many there were.

    Raises
    ------
    ExampleError
        If a command fails, or a value or an output is not what the page says.
    """
    text = page.read_text("utf-8")
    again, count = _run(page, directory)
    if not _alike(text, again):
        raise ExampleError(f"{page.name}: {_difference(text, again)}")
    return count


def write(page: Path) -> None:
    """Run the examples of a page and write their outputs and pictures."""
    with tempfile.TemporaryDirectory() as directory:
        text, _ = _run(page, Path(directory), pictures=True)
    if not _alike(page.read_text("utf-8"), text):
        page.write_text(text, encoding="utf-8")


def _run(page: Path, directory: Path, *, pictures: bool = False) -> tuple[str, int]:
    """Text of a page with its current outputs, and the number of examples."""
    session = _Session(directory, page, {}, [])
    parts, end, count = [], 0, 0
    text = page.read_text("utf-8")
    before = Path.cwd()
    os.chdir(directory)
    sys.path.insert(0, str(directory))
    try:
        for match in _BLOCK.finditer(text):
            parts.append(text[end : match.start()])
            parts.append(_picture(session, match, pictures) if match["source"] else _block(session, match))
            count += match["language"] in ("python", "console") or match["source"] is not None
            end = match.end()
    finally:
        sys.path.remove(str(directory))
        os.chdir(before)
        for process in session.background:
            os.killpg(process.pid, signal.SIGTERM)
            process.wait()
    return "".join([*parts, text[end:]]), count


def _block(session: _Session, match: re.Match[str]) -> str:
    text = match["text"]
    if title := _TITLE.search(match["info"]):
        path = session.directory / title["name"]
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("a" if title["added"] else "w", encoding="utf-8") as file:
            file.write(("\n" if title["added"] else "") + text)
    elif match["language"] == "python":
        run_block(text, session.names)
    elif match["language"] == "console":
        return match[0].replace(text, "".join(_console(session, text, match["show"])))
    return match[0]


def run_block(text: str, names: dict[str, Any]) -> None:
    """Run Python code and check each expression that ends in ``# -> value``.

    Raises
    ------
    ExampleError
        If a value differs.
    """
    lines = text.splitlines()
    for statement in ast.parse(text).body:
        source = ast.get_source_segment(text, statement)
        assert source is not None
        if not isinstance(statement, ast.Expr):
            exec(source, names)
            continue
        value = eval(source, names)
        assert statement.end_lineno is not None
        _, _, expected = lines[statement.end_lineno - 1].partition("  # -> ")
        if expected and repr(value) != expected:
            raise ExampleError(f"{source}: {value!r}, documented {expected}")


def _console(session: _Session, text: str, show: str | None) -> Iterator[str]:
    """Commands of a block, each followed by its current output."""
    commands = [line for line in text.splitlines() if line.startswith("$ ")]
    for i, command in enumerate(commands):
        if i and not commands[i - 1].endswith(" &"):
            yield "\n"
        if command.endswith(" &"):
            session.background.append(_started(command[2:-2]))
            yield command + "\n"
            continue
        output = _output(command[2:])
        if show:
            output = shortened(output, [title.strip() for title in show.split("|")])
        yield command + "\n"
        yield output.rstrip() + "\n" if output.strip() else ""


def _environment() -> dict[str, str]:
    """Environment of a shell with the programs beside this Python on its path."""
    programs = os.pathsep.join((str(Path(sys.executable).parent), os.environ["PATH"]))
    return os.environ | {"PATH": programs, "PYTHONWARNINGS": "ignore"}


def _started(command: str) -> subprocess.Popen[bytes]:
    """Start a program, in a session of its own, that runs until the page ends."""
    return subprocess.Popen(
        ["bash", "-c", command],
        env=_environment(),
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )


def _output(command: str) -> str:
    """Output of a command, without its progress messages."""
    done = subprocess.run(
        ["bash", "-c", command],
        env=_environment(),
        capture_output=True,
        text=True,
        timeout=1800,
    )
    # status 2 is an error that the page may want to show
    if done.returncode not in (0, 2):
        raise ExampleError(f"{command}: exit status {done.returncode}\n{done.stdout}{done.stderr}")
    said = [line for line in done.stderr.splitlines() if line.startswith(("error:", "warning:", "    "))]
    return "".join(f"{folded(line.rstrip())}\n" for line in [*said, *done.stdout.splitlines()])


def folded(line: str) -> str:
    """A long sentence of a screen, wrapped; rows of tables, which contain gaps, stay as they are."""
    indent = line[: len(line) - len(line.lstrip())]
    if len(line) <= _WIDTH or "  " in line.strip():
        return line
    return textwrap.fill(
        line.strip(),
        _WIDTH,
        initial_indent=indent,
        subsequent_indent=f"{indent}  ",
        break_long_words=False,
        break_on_hyphens=False,
    )


def shortened(screen: str, titles: list[str]) -> str:
    """Those parts of a screen whose first line begins with one of the titles, "..." for the others.

    Raises
    ------
    ExampleError
        If no part begins with one of the titles.
    """
    parts = re.split(r"\n\s*\n", screen.strip("\n"))
    for title in titles:
        if not any(part.startswith(title) for part in parts):
            raise ExampleError(f"no part of the screen begins with {title!r}:\n{screen}")
    kept: list[str] = []
    for part in parts:
        if part.startswith(tuple(titles)):
            kept.append(part)
        elif not kept or kept[-1] != _OTHERS:
            kept.append(_OTHERS)
    return "\n\n".join(kept) + "\n"


def _picture(session: _Session, match: re.Match[str], write_it: bool) -> str:
    source, picture = session.directory / match["source"], session.page.parent / match["picture"]
    if not source.is_file():
        raise ExampleError(f"{match['source']}: the examples before it do not write this picture")
    if write_it:
        picture.parent.mkdir(exist_ok=True)
        shutil.copy(source, picture)
    if not picture.is_file():
        raise ExampleError(f"{match['picture']}: missing; run python docs/build/examples.py on this page")
    return match[0]


def _alike(documented: str, now: str) -> bool:
    """Whether two texts differ only in durations and in the last digits of numbers.

    The mean of a sampled quantity, written with its standard deviation, may differ by a twentieth of that:
    on another processor rounding draws other samples.
    """
    old, new = (_TIMES.sub("0", _spaced(text)) for text in (documented, now))
    if _NUMBER.sub("0", old) != _NUMBER.sub("0", new):
        return False
    pairs = zip(_NUMBER.finditer(old), _NUMBER.finditer(new), strict=True)
    return all(_near(a[0], b[0], _spread_after(old[a.end() :])) for a, b in pairs)


def _spread_after(text: str) -> float:
    """The standard deviation with which a text goes on, 0 if it does not."""
    found = _SPREAD.match(text)
    return float(found[1]) if found else 0.0


def _spaced(text: str) -> str:
    """Text with each column gap reduced to one space: a longer duration makes a column wider."""
    return re.sub(r"[ ─━]+", " ", text)


def _near(documented: str, now: str, sd: float) -> bool:
    """Whether two numbers differ by at most one unit of the last digit, or by sd / 20: rounding decides."""
    (decimals, exponent), others = _last_digit(documented), _last_digit(now)
    if (decimals, exponent) != others:
        return False
    return abs(float(documented) - float(now)) < max(1.5 * 10.0 ** (exponent - decimals), sd / 20.0)


def _last_digit(number: str) -> tuple[int, int]:
    """Number of decimals of the mantissa, and the exponent."""
    mantissa, _, exponent = number.partition("e")
    return len(mantissa.partition(".")[2]), int(exponent or 0)


def _difference(documented: str, now: str) -> str:
    """The first lines that differ."""
    old, new = documented.splitlines(), now.splitlines()
    for a, b in zip(old, new, strict=False):
        if not _alike(a, b):
            return f"the page has\n{a}\nand now it is\n{b}"
    return f"{len(old)} lines in the page, {len(new)} now"


def main() -> None:
    """Rewrite the outputs of the pages named on the command line."""
    if len(sys.argv) < 2 or sys.argv[1].startswith("-"):
        print(__doc__)
        return
    for page in sys.argv[1:]:
        write(Path(page).resolve())


if __name__ == "__main__":
    main()
