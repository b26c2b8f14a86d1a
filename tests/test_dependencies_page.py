"""docs/dependencies.md against requirements.txt: every requirement has its row and its licence, and none is the GPL."""

import re
from importlib.metadata import PackageNotFoundError, metadata
from pathlib import Path

import pytest
from packaging.requirements import Requirement

ROOT = Path(__file__).resolve().parents[1]
LINES = (ROOT / "requirements.txt").read_text().splitlines()
REQUIRED = [Requirement(line.partition("#")[0]).name for line in LINES if line.partition("#")[0].strip()]
ROWS = [line.strip("|").split("|") for line in (ROOT / "docs" / "dependencies.md").read_text().splitlines()]
LICENCES = {
    name.strip().lower(): row[-1].strip()
    for row in ROWS
    if len(row) == 4
    for name in re.sub(r"\(.*?\)", "", row[0]).split(",")
}


def licence(name):
    """What the installed package says of its licence: an SPDX expression, else classifiers, else a short text."""
    about = metadata(name)
    classes = [entry.rpartition("::")[2] for entry in about.get_all("Classifier", []) if entry.startswith("License")]
    return about.get("License-Expression") or "; ".join(classes) or (about.get("License") or "").partition("\n")[0]


def is_gpl(text):
    """Is it a licence whose conditions a product under Apache-2.0 could not be given on by?"""
    return any(words in re.sub(r"lgpl|lesser general", "", text.lower()) for words in ("gpl", "general public"))


def with_their_own(names):
    """The installed packages among ``names``, and those that they need, directly or not."""
    found, open_names = set(), list(names)
    while open_names:
        name = open_names.pop()
        try:
            needs = metadata(name).get_all("Requires-Dist", [])
        except PackageNotFoundError:
            continue
        if name.lower() not in found:
            found.add(name.lower())
            wanted = map(Requirement, needs)
            open_names += [one.name for one in wanted if one.marker is None or one.marker.evaluate({"extra": ""})]
    return found


@pytest.mark.parametrize("name", REQUIRED)
def test_requirement_has_a_row_with_its_licence(name):
    assert LICENCES.get(name.lower()), "give it a row in docs/dependencies.md"


def test_no_requirement_and_none_of_theirs_is_under_the_gpl():
    names = with_their_own(REQUIRED)
    assert len(names) > len(REQUIRED)
    said = {name: licence(name) for name in names}
    assert not {name: text for name, text in said.items() if is_gpl(text)}


@pytest.mark.parametrize(
    "text", ["GPL-3.0-or-later", " GNU General Public License v3 (GPLv3)", "GNU GENERAL PUBLIC LICENSE"]
)
def test_gpl_is_told_from_the_lesser_one(text):
    assert is_gpl(text)
    assert not is_gpl(
        text.replace("GPL", "LGPL").replace("General", "Lesser General").replace("GENERAL", "LESSER GENERAL")
    )
