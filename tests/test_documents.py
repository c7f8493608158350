"""Documents say what `results/` holds, name what exists, and are short enough to be read."""

import re

import pytest

from tests import documents

GUIDES = sorted((documents.ROOT / "docs").glob("*.md"))
TEXTS = [documents.ROOT / "README.md", *GUIDES]


@pytest.mark.parametrize(("path", "text"), documents.written().items(), ids=lambda value: getattr(value, "name", ""))
def test_numbers_are_those_of_the_results(path, text):
    assert path.read_text() == text, "python -m tests.documents writes it anew"


@pytest.mark.parametrize("path", TEXTS, ids=lambda path: path.name)
def test_links_lead_somewhere(path):
    linked = re.findall(r"\]\(([^)#]+?)(?:#[\w-]*)?\)", path.read_text())
    assert [to for to in linked if "://" not in to and not (path.parent / to).exists()] == []


def test_every_guide_is_linked_from_the_readme():
    text = documents.WRITTEN["README.md"].read_text()
    assert [path.name for path in GUIDES if f"(docs/{path.name})" not in text] == []


def test_the_readme_is_read_in_a_screen_and_a_half():
    lines = documents.WRITTEN["README.md"].read_text().splitlines()
    assert len(lines) <= 100 and max(len(line) for line in lines if line[:1] not in ("|", "!", "[")) <= 120


def test_numbers_of_a_claim_are_taken_apart(monkeypatch):
    ours = "k = 16: O-VIB 4.87 ± 1.21 m, -0.02 ± 0.72 %, 1,234 of H.264; in 2.4 to 3.9 ± 1 m"
    monkeypatch.setattr(documents, "claims", lambda card: [{"statement": "It is so", "ours": ours, "verdict": "held"}])
    found = [documents.said("any", "It", place) for place in range(6)]
    assert found == ["16", "4.87 ± 1.21", "-0.02 ± 0.72", "1,234", "2.4", "3.9 ± 1"]
    assert documents.said("any", "It", 1, 1) == "4.9 ± 1.2"
    assert documents.said("any", "It", 2, spread=False) == "-0.02"
    with pytest.raises(LookupError, match="0 claims"):
        documents.said("any", "Nothing")
