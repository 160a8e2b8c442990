"""Topics with named parts."""

from __future__ import annotations

import pytest

from residua.errors import SettingError
from residua.live.sources.topics import Topics


@pytest.mark.parametrize(
    ("pattern", "asked", "topic", "place"),
    [
        ("plants/{plant}/data", "plants/+/data", "plants/north/data", ("north", "")),
        ("plants/{plant}/data", "plants/+/data", "plants/north/east/data", None),
        ("plants/{plant}/data", "plants/+/data", "plants//data", None),
        ("plants/{plant}/{channel}", "plants/+/+", "plants/a.b/level 1", ("a.b", "level 1")),
        ("line-{plant}/x+", None, "", None),
        ("line-{plant}.v2/x", "+/x", "line-7.v2/x", ("7", "")),
        ("line-{plant}.v2/x", "+/x", "line-7-v2/x", None),
        ("+/{plant}/#", "+/+/#", "a/b", ("b", "")),
        ("+/{plant}/#", "+/+/#", "a/b/c/d", ("b", "")),
        ("data", "data", "data", ("", "")),
        ("#", None, "", None),
        ("a/#/b", None, "", None),
        ("{plant}/{plant}", None, "", None),
        ("{plant}{channel}/a", None, "", None),
        ("{tag}/a", None, "", None),
        ("{channel}/a", None, "", None),
        ("$share/group/{plant}", None, "", None),
        ("$SYS/#", None, "", None),
        ("a{b", None, "", None),
    ],
)
def test_patterns(pattern: str, asked: str | None, topic: str, place: tuple[str, str] | None) -> None:
    if asked is None:
        with pytest.raises(SettingError, match=r"^topics: "):
            Topics([pattern])
    else:
        topics = Topics([pattern])
        assert topics.filters == (asked,)
        assert topics.place(topic) == topics.place(topic) == place


def test_the_first_pattern_that_fits_counts() -> None:
    topics = Topics(["a/{plant}/data", "a/{plant}/{channel}", "a/{channel}"], plant="one")
    assert topics.place("a/b/data") == ("b", "")
    assert topics.place("a/b/c") == ("b", "c")
    assert topics.place("a/b") == ("one", "b")


@pytest.mark.parametrize("pattern", ["a b", "a/b", "", "{plant}{channel}", "{tag}", "a" * 250, "^a.*"])
def test_topics_that_kafka_does_not_have(pattern: str) -> None:
    with pytest.raises(SettingError, match=r"^topics: "):
        Topics([pattern], dotted=True)


def test_topics_with_dots() -> None:
    topics = Topics(["plants.{plant}.data", "tags-{channel}", "rest"], dotted=True)
    assert topics.filters == ("^plants[.][^.]+[.]data$", "^tags-[^.]+$", "rest")
    assert topics.place("plants.north.data") == ("north", "")
    assert topics.place("plants.north.east.data") is None
    assert topics.place("plantsxnorthxdata") is None
    assert topics.place("tags-level") == ("", "level")
    assert topics.place("rest") == ("", "")
