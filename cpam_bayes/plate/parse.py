"""From the text of a plate file to a specimen, or to one error with everything that is wrong."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from cpam_bayes.errors import PlateFileError
from cpam_bayes.plate.build import build_specimen
from cpam_bayes.plate.checks import relation_problems
from cpam_bayes.plate.mode_shapes.read import shapes_of
from cpam_bayes.plate.modes_table.read import table_of
from cpam_bayes.plate.problems import plate_file_error, schema_problems
from cpam_bayes.plate.records import Specimen
from cpam_bayes.plate.schema import PlateFile
from cpam_bayes.plate.toml_lines import Path as KeyPath
from cpam_bayes.plate.toml_lines import line_numbers

# The parser of the standard library takes time quadratic in the parts of one dotted key.
_MAX_KEY_PARTS: Final = 100
_KEY_END = re.compile(r"[=,{}\[\]#\n]")
_PLACE = re.compile(r"\s*\(at (?:line (\d+), column (\d+)|end of document)\)$")


def parse_specimen(text: str, source: str, directory: Path | None = None) -> Specimen:
    """Read the text of a plate file.

    source : how messages name the file.
    directory : where its relative paths begin
    raises PlateFileError with all problems, each with file, line and key
    """
    return specimen_of(_load(text, source), source, directory, line_numbers(text))


def specimen_of(
    data: Mapping[str, Any], source: str, directory: Path | None, lines: Mapping[KeyPath, int]
) -> Specimen:
    """Check the content of a plate file; arguments and errors as `parse_specimen`.

    lines : where each key stands, empty for what was not read from a text
    """
    of_table, table_problems = table_of(data, directory)
    of_shapes, shape_problems = shapes_of(data, directory)
    problems = schema_problems(data) + relation_problems(data, directory) + table_problems + shape_problems
    if problems:
        raise plate_file_error(source, problems, lines)
    file = PlateFile.model_validate(data)
    measured: dict[str, Any] = {}
    if file.measurement is not None and of_table is not None:
        measured = of_table.fields(str(file.measurement.table))
    if file.measurement is not None and of_shapes is not None:
        measured = of_shapes.fields(str(file.measurement.shapes))
    return build_specimen(file, source, directory, measured)


def _load(text: str, source: str) -> Mapping[str, Any]:
    for number, line in enumerate(text.split("\n"), start=1):
        if line.count(".") > _MAX_KEY_PARTS:
            parts = max(part.count(".") for part in _KEY_END.split(line.partition("#")[0]))
            if parts > _MAX_KEY_PARTS:
                raise PlateFileError(
                    f"{source}:{number}: file: a key of {parts + 1} parts, accepted: up to {_MAX_KEY_PARTS}"
                )
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise PlateFileError(_invalid(str(error), text, source)) from None
    except RecursionError:
        raise PlateFileError(f"{source}:1: file: arrays or tables nested too deeply") from None
    except ValueError as error:
        raise PlateFileError(f"{source}:1: file: not valid TOML: {error}") from None


def _invalid(message: str, text: str, source: str) -> str:
    place = _PLACE.search(message)
    what = _PLACE.sub("", message)
    if place is not None and place.group(1):
        line, where = int(place.group(1)), f" at column {place.group(2)}"
    else:
        line, where = text.rstrip().count("\n") + 1, " at the end of the file"
    shown = text.split("\n")[line - 1].strip() if line <= text.count("\n") + 1 else ""
    quoted = "".join(c if c.isprintable() else " " for c in shown[:60])
    return f"{source}:{line}: file: not valid TOML, {what}{where}, received: {quoted}"
