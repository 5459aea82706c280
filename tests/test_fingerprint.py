"""A result names the sources that it depends on, and no others."""

import ast
from pathlib import Path

import pytest

import cpam_bayes as cb
from cpam_bayes import fingerprint as module
from cpam_bayes.fingerprint import fingerprint, fingerprint_of_script, sources_of


def names(of: str) -> set[str]:
    package = Path(module.__file__).parent
    return {file.relative_to(package).as_posix() for file in sources_of([of], [])}


def test_the_sources_of_a_result_are_those_it_imports_at_any_depth() -> None:
    found = names("cpam_bayes.forward_model.build")
    assert {"forward_model/build.py", "mechanics/affine.py", "plate/laminate.py"} <= found
    assert "diagnosis/models.py" not in found
    # how an answer looks is no part of it
    assert not any(n.startswith(("render/", "cli", "command")) for n in names("cpam_bayes.questions.forward"))


def test_another_source_is_another_fingerprint(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    (tmp_path / "one.py").write_text("from cpam_bayes.two import (\n    a,\n    b,\n)\n")
    (tmp_path / "two.py").write_text("a = b = 1\n")
    (tmp_path / "apart.py").write_text("c = 1\n")
    monkeypatch.setattr(module, "_PACKAGE", tmp_path)
    fingerprint.cache_clear()
    first = fingerprint("cpam_bayes.one")
    for name, text, same in (
        ("apart.py", "c = 2\n", True),
        ("two.py", "a = b = 1\r\n", True),
        ("two.py", '"""Words\n\nand more."""\n\na = b = 1\n\n# a remark\n', True),
        ("two.py", 'a = b = """1"""\n', False),
        ("two.py", "a = 2\n", False),
    ):
        (tmp_path / name).write_text(text, newline="")
        fingerprint.cache_clear()
        assert (fingerprint("cpam_bayes.one") == first) is same, name
    fingerprint.cache_clear()


def test_nothing_but_words_is_left_out_of_the_sources_of_the_package() -> None:
    for file in Path(module.__file__).parent.rglob("*.py"):
        source = file.read_text(encoding="utf-8")
        said: set[int] = set()
        for node in ast.walk(ast.parse(source)):
            if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
                lines = range(node.lineno, (node.end_lineno or node.lineno) + 1)
                said.update(lines if isinstance(node.value.value, str) else ())
        code = [line for number, line in enumerate(source.splitlines(), 1) if number not in said]
        left = module.without_words(source).splitlines()
        assert [line for line in left if _is_code(line)] == [line for line in code if _is_code(line)], file


def _is_code(line: str) -> bool:
    return bool(line.strip()) and not line.strip().startswith("#")


def test_a_script_has_the_fingerprint_of_what_it_uses(tmp_path: Path) -> None:
    script = tmp_path / "study.py"
    script.write_text("from cpam_bayes.formatting import fixed\n")
    first = fingerprint_of_script(script, cb._PUBLIC)
    script.write_text("from cpam_bayes.formatting import fixed  # a remark\n")
    assert fingerprint_of_script(script, cb._PUBLIC) == first
    script.write_text("from cpam_bayes.plate.records import Plate\n")
    assert fingerprint_of_script(script, cb._PUBLIC) != first


def test_a_script_that_calls_public_names_depends_on_what_answers_them(tmp_path: Path) -> None:
    found = {}
    for name in ("plates", "forward"):
        script = tmp_path / f"{name}.py"
        script.write_text(f"import cpam_bayes as cb\ncb.{name}()\n")
        found[name] = fingerprint_of_script(script, cb._PUBLIC)
    assert len(set(found.values())) == 2


def test_every_document_holds_the_fingerprint_of_its_question() -> None:
    result = cb.plates()
    assert result.to_dict()["fingerprint"] == fingerprint(type(result).__module__)
