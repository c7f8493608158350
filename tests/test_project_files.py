"""The files beside the code say what the code says: one version, hooks that CI runs too."""

import re
import tomllib
from pathlib import Path

import yaml

import ovibjax

ROOT = Path(__file__).parents[1]


def text_of(name):
    return (ROOT / name).read_text()


def test_the_version_stands_in_one_place():
    project = tomllib.loads(text_of("pyproject.toml"))
    assert project["project"]["dynamic"] == ["version"] and "version" not in project["project"]
    assert project["tool"]["hatch"]["version"]["path"] == "ovibjax/__init__.py"


def test_citation_and_changelog_are_of_this_version():
    citation = yaml.safe_load(text_of("CITATION.cff"))
    assert citation["version"] == ovibjax.__version__
    assert citation["license"] == "Apache-2.0" and len(citation["preferred-citation"]["authors"]) == 8
    first = re.search(r"^## (\S+)", text_of("CHANGELOG.md"), re.MULTILINE)
    assert first is not None and first[1] == ovibjax.__version__


def test_hooks_run_what_ci_runs():
    hooks = yaml.safe_load(text_of(".pre-commit-config.yaml"))["repos"][0]["hooks"]
    entries = " ".join(hook["entry"] for hook in hooks)
    for tool in ("ruff check", "ruff format", "mypy"):
        assert tool in entries and tool in text_of(".ci/run")
    for test in re.findall(r"tests/\S+\.py", entries):
        assert (ROOT / test).is_file()
