"""Format docstrings for the API page: an extension of griffe, with which mkdocstrings reads them.

The package writes ``name : description``, one per line, in sections and in plain paragraphs. numpydoc would
take the text after the colon for a type; the types stand in the signatures.
"""

from __future__ import annotations

import re
from typing import Any

import griffe

_FIELD = re.compile(r"^(?P<names>`{0,2}\w[\w*`]*(?:, `{0,2}\w[\w*`]*)*) : (?P<text>\S.*)$")
_SECTION = re.compile(r"^-{3,}$", re.MULTILINE)


class FieldLists(griffe.Extension):
    """Turn fields in plain paragraphs into lists, and complete the descriptions of those in sections."""

    def on_object(self, *, obj: griffe.Object, **_: Any) -> None:
        """Change the docstring of an object before it is shown."""
        if obj.docstring is None:
            return
        obj.docstring.value = _listed(obj.docstring.value)
        for section in obj.docstring.parsed:
            if isinstance(section, griffe.DocstringSectionParameters | griffe.DocstringSectionAttributes):
                for field in section.value:
                    _described(field, obj)


def _described(field: Any, obj: griffe.Object) -> None:
    """Move text that was taken for a type to the front of the description."""
    text = str(field.annotation or "")
    names = [name.strip() for name in field.name.split(",")]
    known = {parameter.name: parameter.annotation for parameter in getattr(obj, "parameters", ())}
    annotation = known.get(names[0])
    if text and text != str(annotation):
        field.description = f"{text} {field.description}".strip()
        field.annotation = annotation


def _listed(text: str) -> str:
    """Text with its paragraphs of fields as lists, up to the first section with an underlined title."""
    section = _SECTION.search(text)
    head, tail = (text, "") if section is None else _split_before_title(text, section.start())
    return "\n\n".join(_as_list(paragraph) for paragraph in head.split("\n\n")) + tail


def _split_before_title(text: str, underline: int) -> tuple[str, str]:
    title = text.rfind("\n\n", 0, underline)
    return (text[:title], text[title:]) if title >= 0 else ("", text)


def _as_list(paragraph: str) -> str:
    lines = paragraph.split("\n")
    start = next((i for i, line in enumerate(lines) if _FIELD.match(line)), None)
    if start is None:
        return paragraph
    fields = [
        f"- **{match['names'].replace('`', '')}**: {match['text']}"
        if (match := _FIELD.match(line))
        else f"  {line.strip()}"
        for line in lines[start:]
    ]
    return "\n".join([*lines[:start], *([""] if start else []), *fields])
