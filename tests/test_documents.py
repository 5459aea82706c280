"""Every command's document has a schema, which the documentation includes and every document follows."""

import argparse
import copy
from collections.abc import Iterator
from importlib import import_module
from typing import Any

import jsonschema
import pytest

import cpam_bayes as cb
from cpam_bayes.cli import COMMANDS
from cpam_bayes.documents import DOCUMENTS, json_schema, validated

WRONG = [("colour", "black"), ("lenght_mm", 300.0), ("length_mm", "300"), ("width_mm", True), ("edges", ...)]
PLATES = cb.plates().to_dict()


def objects(schema: Any) -> Iterator[dict[str, Any]]:
    for part in schema.values() if isinstance(schema, dict) else schema:
        if isinstance(part, dict | list):
            yield from objects(part)
    if isinstance(schema, dict) and isinstance(schema.get("properties"), dict):
        yield schema


@pytest.mark.parametrize("command", sorted({*DOCUMENTS, *COMMANDS}))
def test_every_command_has_a_schema_of_draft_2020_12_whose_objects_take_no_other_keys(command):
    parser = argparse.ArgumentParser()
    import_module(f"cpam_bayes.questions.{command}").COMMAND.add_to(parser)
    assert any("--json" in action.option_strings for action in parser._actions)
    schema = json_schema(command)
    assert schema["$schema"] == "https://json-schema.org/draft/2020-12/schema"
    jsonschema.Draft202012Validator.check_schema(schema)
    for found in objects(schema):
        assert (found["additionalProperties"], bool(found["description"])) == (False, True)


@pytest.mark.parametrize(("key", "value"), [*WRONG, ("material", None), ("symmetry", "cubic")])
def test_a_wrong_key_a_missing_key_and_a_wrong_type_are_refused(key, value):
    document = copy.deepcopy(PLATES)
    document["plates"][0][key] = value
    if value is ...:
        del document["plates"][0][key]
    with pytest.raises(ValueError, match=rf"plates\.0\.{key}"):
        validated("plates", document)
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate(document, json_schema("plates"))


def test_whole_numbers_are_numbers_and_another_command_is_refused(monkeypatch):
    document = copy.deepcopy(PLATES)
    document["plates"][0]["length_mm"] = 300
    assert validated("plates", document) is document
    jsonschema.validate(document, json_schema("plates"))
    with pytest.raises(ValueError, match="forward"):
        validated("forward", document)
    with pytest.raises(ValueError, match="command: received 'plate', accepted: app batch"):
        json_schema("plate")
    monkeypatch.setattr("cpam_bayes.questions.plates.__version__", 1)  # tests/conftest.py validates documents
    with pytest.raises(AssertionError, match="plates: 1 validation error"):
        cb.plates().to_dict()
