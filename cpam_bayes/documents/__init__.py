"""The JSON documents of the commands: their keys, units and types, as JSON schemas.

Each document is declared once, as a `TypedDict`, from which its schema is made.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from typing import Any, Final

from pydantic import ConfigDict, TypeAdapter, with_config
from pydantic.json_schema import GenerateJsonSchema
from typing_extensions import is_typeddict

from cpam_bayes.documents.constants import Identify, Report, Sequence
from cpam_bayes.documents.diagnosis import Diagnose
from cpam_bayes.documents.modes import App, Design, Export, Forward, New, Plates, Poles, Predict, Prove
from cpam_bayes.documents.studies import Batch, Calibrate, Compare, Paper, Sensitivity
from cpam_bayes.forward_model.preconditions import require_choice
from cpam_bayes.render.report import json_text

__all__ = ["DOCUMENTS", "json_schema", "validated"]

DOCUMENTS: Final[Mapping[str, Any]] = {
    "app": App,
    "batch": Batch,
    "calibrate": Calibrate,
    "compare": Compare,
    "design": Design,
    "diagnose": Diagnose,
    "export": Export,
    "forward": Forward,
    "identify": Identify,
    "new": New,
    "paper": Paper,
    "plates": Plates,
    "poles": Poles,
    "predict": Predict,
    "prove": Prove,
    "report": Report,
    "sensitivity": Sensitivity,
    "sequence": Sequence,
}
"""Command -> type of its document."""

_CLOSED: Final = ConfigDict(extra="forbid", strict=True)


class _Schemas(GenerateJsonSchema):
    """Closed objects without titles of keys, equal for all versions of pydantic."""

    def field_title_should_be_set(self, schema: Any) -> bool:
        return False

    def typed_dict_schema(self, schema: Any) -> dict[str, Any]:
        return {**super().typed_dict_schema(schema), "additionalProperties": False}

    def literal_schema(self, schema: Any) -> dict[str, Any]:
        found = super().literal_schema(schema)
        return {key: value for key, value in found.items() if key != "enum" or "const" not in found}


@cache
def _adapter(command: str) -> TypeAdapter[Any]:
    require_choice("command", command, tuple(DOCUMENTS))
    document = DOCUMENTS[command]
    if is_typeddict(document):
        return TypeAdapter(with_config(_CLOSED)(document))
    return TypeAdapter(document, config=_CLOSED)


def json_schema(command: str) -> dict[str, Any]:
    """The JSON schema of a command's document, draft 2020-12.

    Raises
    ------
    ValueError
        If there is no such command.

    Examples
    --------
    >>> from cpam_bayes.documents import json_schema
    >>> json_schema("compare")["properties"]["command"]
    {'const': 'compare', 'type': 'string'}
    """
    schema = _adapter(command).json_schema(schema_generator=_Schemas)
    head = {"$schema": _Schemas.schema_dialect, "$id": f"{command}.json", "title": f"cpam-bayes {command}"}
    return {**head, **{key: value for key, value in schema.items() if key not in head}}


def validated(command: str, document: Mapping[str, Any]) -> Mapping[str, Any]:
    """The document itself, if it has the keys and types of its command's schema.

    Raises
    ------
    ValueError
        If it has not; the message names each key.
    """
    _adapter(command).validate_json(json_text(document))
    return document
