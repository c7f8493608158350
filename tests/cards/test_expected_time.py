"""The time that is left: scaled by what was seen, said in words, and known for every card."""

import ast

import pytest

from ovibjax.cards.catalog import card_names, cards_folder
from ovibjax.cards.expected_time import REFERENCE_S, in_words, remaining_s
from ovibjax.cards.job import PRESETS, STAGES
from tests.test_house import PACKAGE


def test_every_card_and_preset_has_its_time():
    assert sorted(REFERENCE_S) == card_names()
    assert all(len(row) == len(PRESETS) and min(row) > 0 for row in REFERENCE_S.values())


def test_the_rest_is_as_much_slower_as_what_was_seen():
    names = card_names()
    quick = {name: row[PRESETS.index("quick")] for name, row in REFERENCE_S.items()}
    seen = {name: 3.0 * quick[name] for name in names[:4]}
    assert remaining_s("quick", seen, names[4:]) == pytest.approx(3.0 * sum(quick[name] for name in names[4:]))
    assert remaining_s("quick", seen, []) == 0.0


def test_nothing_is_said_of_what_nobody_knows():
    one, two = card_names()[:2]
    assert remaining_s("quick", {}, [one]) is None
    assert remaining_s("quick", {"mine": 5.0}, [one]) is None
    assert remaining_s("quick", {one: 5.0}, ["mine"]) is None
    assert remaining_s("quick", {one: 5.0, "mine": 100.0}, [two]) == remaining_s("quick", {one: 5.0}, [two])


@pytest.mark.parametrize(
    ("seconds", "words"),
    [(0.2, "some 5 s"), (61, "some 60 s"), (100, "some 2 min"), (5000, "some 83 min"), (9000, "some 2.5 h")],
)
def test_words(seconds, words):
    assert in_words(seconds) == words


def stages_named():
    """Every stage that the cards and what they share name in their source."""
    for path in [*cards_folder().glob("*.py"), *(PACKAGE / "cards").glob("*.py")]:
        for node in ast.walk(ast.parse(path.read_text())):
            if not isinstance(node, ast.Call):
                continue
            called = getattr(node.func, "attr", getattr(node.func, "id", ""))
            given = [*(node.args if called == "stage" else []), *(k.value for k in node.keywords if k.arg == "stage")]
            yield from (value.value for value in given if isinstance(value, ast.Constant))


def test_stages_have_the_same_names_everywhere():
    assert set(stages_named()) == set(STAGES)
