"""A result names the sources that it depends on, and no others."""

import ast
from pathlib import Path

import cpam_bayes as cb
from cpam_bayes import fingerprint as module
from cpam_bayes.fingerprint import fingerprint, fingerprint_of_script, sources_of


def test_the_sources_of_a_result_are_those_it_imports_at_any_depth():
    package = Path(module.__file__).parent
    names = [f"cpam_bayes.{name}" for name in ("forward_model.build", "questions.forward")]
    found, asked = ({file.relative_to(package).as_posix() for file in sources_of([n], [])} for n in names)
    assert {"forward_model/build.py", "mechanics/affine.py", "plate/laminate.py"} <= found
    assert "diagnosis/models.py" not in found
    assert not any(name.startswith(("render/", "cli", "command")) for name in asked)
    result = cb.plates()
    assert result.to_dict()["fingerprint"] == fingerprint(type(result).__module__)


def test_another_source_is_another_fingerprint(monkeypatch, tmp_path):
    one = "from cpam_bayes.two import (\n    a,\n    b,\n)\n"
    for name, text in (("one.py", one), ("two.py", "a = b = 1\n"), ("apart.py", "c = 1\n")):
        (tmp_path / name).write_text(text)
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


def test_nothing_but_words_is_left_out_of_the_sources_of_the_package():
    def code(source: str, said: set[int]) -> list[str]:
        lines = [line for number, line in enumerate(source.splitlines(), 1) if number not in said]
        return [line for line in lines if line.strip() and not line.strip().startswith("#")]

    for file in Path(module.__file__).parent.rglob("*.py"):
        source = file.read_text(encoding="utf-8")
        said: set[int] = set()
        for node in ast.walk(ast.parse(source)):
            if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
                lines = range(node.lineno, (node.end_lineno or node.lineno) + 1)
                said.update(lines if isinstance(node.value.value, str) else ())
        assert code(module.without_words(source), set()) == code(source, said), file


def test_a_script_has_the_fingerprint_of_what_it_uses_and_what_answers_public_names(tmp_path):
    script, found = tmp_path / "study.py", []
    for text in (
        *(f"from cpam_bayes.formatting import fixed{remark}\n" for remark in ("", "  # a remark")),
        "from cpam_bayes.plate.records import Plate\n",
        *(f"import cpam_bayes as cb\ncb.{verb}()\n" for verb in ("plates", "forward")),
    ):
        script.write_text(text)
        found.append(fingerprint_of_script(script, cb._PUBLIC))
    assert (found[0], len(set(found))) == (found[1], 4)
