"""Sentences of README and documentation are short.

``python tests/test_prose.py PAGE...`` prints the mean of each page and every sentence that is too long.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).resolve().parent.parent
DOCS = REPOSITORY / "docs"
WRITTEN = sorted([*DOCS.glob("*.rst"), *DOCS.glob("how-to/*.rst")])
PAGES = ["README.md", *(page.relative_to(REPOSITORY).as_posix() for page in WRITTEN)]
DOORS = ("i-have-a-log", "getting-started", "i-have-a-paper")
LONGEST, MEAN = 25, 18  # words

FENCED = re.compile(r"^ *```.*?^ *```$", re.MULTILINE | re.DOTALL)
ADMONITION = re.compile(r"\.\. (note|tip|warning|important)::")
SKIPPED = re.compile(r">>>|\.\.( |$)|\||\+-|={3,}|#+ |<|:[\w ]+:( |$)")
RULE = re.compile(r"\s*([=\-~^])\1{2,}\s*$")
BULLET = re.compile(r"\s*([-*]|\d+\.|#\.) +(?=\S)")
LINK = re.compile(r"!?\[([^\]]*)\]\([^)]*\)")
QUOTED = re.compile(r"``.+?``|(?::(?P<role>\w+):)?`(?P<text>[^`]*?)\s*(?:<[^`>]*>)?`(?P<reference>_*)", re.DOTALL)
ABBREVIATION = re.compile(r"\b(e\.g|i\.e|vs|cf|al)\.")
END = re.compile(r"(?<=[.!?])[\"”)*]*\s+(?=[\"“(*]*[A-Z0-9])")


def indent(line: str) -> int:
    return len(line) - len(line.lstrip())


def paragraphs(text: str) -> Iterator[tuple[int, str]]:
    """Yield the line and the text of each paragraph, list item and term; no code, table, heading or directive."""
    text = ADMONITION.sub("", FENCED.sub(lambda block: "\n" * block[0].count("\n"), text))
    deeper = 10**6  # what stands deeper than this belongs to a directive or a literal block
    for block in re.finditer(r"(?:^.*\S.*\n?)+", text, re.MULTILINE):
        lines, number = block[0].splitlines(), text.count("\n", 0, block.start()) + 1
        if indent(lines[0]) > deeper:
            continue
        deeper, first = 10**6, lines[0].lstrip()
        if SKIPPED.match(first):
            deeper = indent(lines[0]) if first.startswith("..") else deeper
            continue
        taken: list[str] = []
        depth = 0
        for offset, line in enumerate(lines):
            if RULE.match(line):
                taken = []
                continue
            bullet = BULLET.match(line)
            if taken and (bullet or indent(line) > depth):
                yield number + offset - len(taken), "\n".join(taken)
                taken = []
            depth = bullet.end() if bullet else indent(line)
            taken.append(line[bullet.end() :] if bullet else line)
        if taken:
            yield number + len(lines) - len(taken), "\n".join(taken)
            deeper = depth if taken[-1].endswith("::") else deeper


def plain(quoted: re.Match[str]) -> str:
    """Return the text of a reference to a page, and one word for code."""
    if quoted["reference"] or quoted["role"] in ("doc", "ref"):
        return quoted["text"]
    return "Code" + "\n" * quoted[0].count("\n")


def sentences(text: str) -> Iterator[tuple[int, str]]:
    """Yield the line and the text of each sentence."""
    for number, paragraph in paragraphs(text):
        prose = ABBREVIATION.sub(r"\1", QUOTED.sub(plain, LINK.sub(r"\1", paragraph)))
        start = 0
        for end in [*(match.end() for match in END.finditer(prose)), len(prose)]:
            if sentence := " ".join(prose[start:end].split()):
                yield number + prose.count("\n", 0, start), sentence
            start = end


def words(sentence: str) -> int:
    return len(re.findall(r"\S*\w\S*", sentence))


@pytest.mark.parametrize("page", PAGES)
def test_sentences_are_short(page: str) -> None:
    found = list(sentences((REPOSITORY / page).read_text(encoding="utf-8")))
    long = [f"{page}:{line}: {words(text)} words: {text}" for line, text in found if words(text) > LONGEST]
    assert not long, "\n".join(long)
    assert sum(words(text) for _, text in found) <= MEAN * len(found)


@pytest.mark.parametrize("door", DOORS)
def test_a_door_is_one_short_page(door: str) -> None:
    assert len((DOCS / f"{door}.rst").read_text(encoding="utf-8").split()) <= 800


def test_the_start_page_has_ten_rows_at_most() -> None:
    assert (DOCS / "index.rst").read_text(encoding="utf-8").count("   * - ") <= 10


def test_a_long_sentence_is_found_where_it_stands() -> None:
    text = f"Title\n=====\n\n.. note::\n   Short.\n\n   It is {'very ' * 25}long. So.\n\nSee::\n\n  {'y ' * 30}\n"
    assert [(line, words(sentence)) for line, sentence in sentences(text)] == [(5, 1), (7, 28), (7, 1), (9, 1)]


if __name__ == "__main__":
    for name in sys.argv[1:]:
        counted = [(line, words(text), text) for line, text in sentences(Path(name).read_text(encoding="utf-8"))]
        print(f"{name}: {len(counted)} sentences, mean {sum(count for _, count, _ in counted) / len(counted):.1f}")
        for line, count, text in counted:
            if count > LONGEST:
                print(f"  {name}:{line}: {count} words: {text}")
