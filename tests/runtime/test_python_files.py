"""Somebody's Python files as modules: what they may do, and their faults on one line."""

import sys

import pytest

from ovibjax.errors import InputError
from ovibjax.runtime.python_files import import_file, told


def refusal(path):
    with pytest.raises(InputError) as caught:
        import_file(path, "mine.faulty")
    assert "mine.faulty" not in sys.modules
    return str(caught.value)


def test_a_file_becomes_a_module_and_nothing_is_written(tmp_path):
    path = tmp_path / "my-file.py"
    # Dataclasses with annotations as text look their module up.
    path.write_text(
        "from __future__ import annotations\nfrom dataclasses import dataclass\n"
        "@dataclass\nclass A:\n    x: int = 3\ny = A().x\n"
    )
    module = import_file(path, "mine.good")
    assert module.y == 3 and module.__file__ == str(path) and sys.modules.pop("mine.good") is module
    path.write_text("y = 4")
    assert import_file(path, "mine.good").y == 4
    assert list(tmp_path.iterdir()) == [path] and sys.modules.pop("mine.good")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("x = 1\n\ny = x / 0\n", "does not import: a.py, line 3: ZeroDivisionError: division by zero"),
        ("def f():\n    raise ValueError('two\\nlines')\nf()", "a.py, line 2: ValueError: two lines"),
        ("import nothing_of_this_name", "line 1: ModuleNotFoundError: No module named 'nothing_of_this_name'"),
        ("x = (\n", "SyntaxError: '(' was never closed (a.py, line 1)"),
        ("raise SystemExit(3)", "SystemExit: 3"),
        ("\0", "does not import"),
    ],
)
def test_a_fault_is_told_with_its_place(tmp_path, text, words):
    path = tmp_path / "a.py"
    path.write_text(text)
    said = refusal(path)
    assert said.startswith(f"{path}: ") and words in said and "\n" not in said


def test_what_is_no_file_is_refused(tmp_path):
    assert refusal(tmp_path / "none.py").endswith("none.py: no such file")
    assert "is a folder" in refusal(tmp_path)


def test_the_innermost_place_in_the_folder_is_told(tmp_path, monkeypatch):
    (tmp_path / "helper_of_a.py").write_text("\ndef f():\n    return {}['gamma']\n")
    (tmp_path / "a.py").write_text("import helper_of_a\ndef g():\n    return helper_of_a.f()\n")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "helper_of_a", raising=False)
    module = import_file(tmp_path / "a.py", "mine.good")
    with pytest.raises(KeyError) as caught:
        module.g()
    assert told(caught.value, tmp_path / "a.py") == "helper_of_a.py, line 3: KeyError: 'gamma'"
    for name in ("mine.good", "helper_of_a"):
        del sys.modules[name]
