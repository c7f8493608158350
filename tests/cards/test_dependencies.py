"""The hash of the code that a figure depends on, and whether the figures in results/ are of this code."""

import json
from pathlib import Path

import pytest

from ovibjax.cards import dependencies
from ovibjax.cards.catalog import card_names, card_paths
from ovibjax.cards.dependencies import bare, code_hash, imported, modules_of, outdated

ROOT = Path(__file__).parents[2]
CARD = '"""A card."""\n\nfrom ovibjax.report.rows import write_rows\n\nTITLE = "One"\n'


def written(folder, text):
    path = folder / "card.py"
    path.write_text(text)
    return path


def test_words_do_not_count_and_code_does(tmp_path):
    before = code_hash(written(tmp_path, CARD))
    other_words = (
        '"""Another sentence,\non two lines."""\n\n\n# Why.\nfrom ovibjax.report.rows import write_rows  # so\n'
    )
    assert code_hash(written(tmp_path, other_words + 'TITLE = "One"\n')) == before
    assert code_hash(written(tmp_path, CARD.replace("One", "Two"))) != before
    # A string that looks like a comment, and one that is no docstring, are code.
    assert code_hash(written(tmp_path, CARD + 'x = "# a"\n')) != code_hash(written(tmp_path, CARD + 'x = "# b"\n'))


def test_docstrings_of_functions_and_fields_do_not_count():
    bald = bare(
        'def f(x):\n    """Say.\n\n    More.\n    """\n    # why\n    return x  # what\n\n\nA = 1\n"""Of A."""\n'
    )
    assert bald == "def f(x):\n    return x\nA = 1"


def test_a_module_that_is_imported_by_one_that_is_imported_counts(tmp_path, monkeypatch):
    card = written(tmp_path, "from ovibjax.report.best import choose\n")
    assert {"report.best", "report.means", "report.labels", "runtime.plain_numbers"} <= set(modules_of(card))
    before = code_hash(card)
    real = dependencies._read

    def edited(name):
        text, names = real(name)
        return (f"{text}\nmore = 1", names) if name == "report.labels" else (text, names)

    monkeypatch.setattr(dependencies, "_read", edited)
    assert code_hash(card) != before


def test_imports_in_functions_and_of_whole_rooms_count():
    assert list(imported("def f():\n    from ovibjax.report import figures as fig\n")) == ["report.figures"]
    assert {"report.figures", "report.claims"} <= set(imported("from ovibjax import report\n"))
    assert list(imported("import ovibjax\nimport numpy as np\nfrom numpy import ovibjax\n")) == []


def test_cards_depend_on_what_they_draw_with_and_not_on_other_topics():
    modules = {path.stem: modules_of(path) for path in card_paths(card_names())}
    assert all("report.figures" in names for names in modules.values())
    assert "scheduling.rules" in modules["multi_client"] and "scheduling.rules" not in modules["encoder_ablation"]
    assert not any(name.startswith("cli.") for names in modules.values() for name in names)


def test_figures_of_other_code_are_named(tmp_path):
    name, path = "setup", card_paths(["setup"])[0]
    folder = tmp_path / name
    folder.mkdir()
    for facts, reason in (({}, "do not say"), ({"code": "0" * 16}, "other code")):
        (folder / "provenance.json").write_text(json.dumps(facts))
        assert reason in outdated(tmp_path)[name]
    (folder / "provenance.json").write_text(json.dumps({"code": code_hash(path)}))
    assert outdated(tmp_path) == {}


@pytest.mark.release
def test_no_figure_in_results_is_older_than_its_code():
    assert outdated(ROOT / "results") == {}


@pytest.mark.release
def test_results_are_one_run_of_one_clean_commit():
    facts = [json.loads(path.read_text()) for path in (ROOT / "results").glob("*/provenance.json")]
    for key in ("version", "commit", "machine", "preset", "jax", "python"):
        assert len({fact[key] for fact in facts}) == 1, key
    assert len(facts) == len(card_names()) and "dirty" not in facts[0]["commit"]
