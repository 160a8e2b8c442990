"""Topics with named parts, of MQTT and Kafka: subscriptions, and the plant and channel of a message."""

from __future__ import annotations

import re
from collections.abc import Sequence

from residua.errors import SettingError
from residua.visible import echo

#: Topics that are remembered; when there are more, they are looked at anew.
_REMEMBERED = 100_000
_PART = re.compile(r"\{(\w*)\}")
_KAFKA = re.compile(r"[A-Za-z0-9._-]{1,249}")


class Topics:
    """Patterns such as ``plants/{plant}/data`` and ``plants/{plant}/{channel}``.

    A named part stands for one level, or for a part of one: ``line-{plant}``. ``+`` and ``#`` stand for what MQTT has
    them for. Of several patterns that fit, the first one counts.

    Parameters
    ----------
    patterns : sequence of str
    plant : str
        The plant of topics without ``{plant}``; empty: the message says it.
    dotted : bool
        Whether levels are parted by dots, as Kafka's usually are: what is asked for is then a regular expression where
        a part is named.

    Raises
    ------
    SettingError
        If a pattern is none.

    Examples
    --------
    >>> topics = Topics(["plants/{plant}/data", "plants/{plant}/{channel}"])
    >>> topics.filters
    ('plants/+/data', 'plants/+/+')
    >>> topics.place("plants/north/data"), topics.place("plants/north/level"), topics.place("other")
    (('north', ''), ('north', 'level'), None)
    >>> Topics(["plants.{plant}.data", "one"], dotted=True).filters
    ('^plants[.][^.]+[.]data$', 'one')
    """

    def __init__(self, patterns: Sequence[str], plant: str = "", dotted: bool = False) -> None:
        parsed = [_dotted(pattern) if dotted else _pattern(pattern) for pattern in patterns]
        self.filters = tuple(dict.fromkeys(one for one, _ in parsed))
        self._expressions = [one for _, one in parsed]
        self._plant = plant
        self._known: dict[str, tuple[str, str] | None] = {}
        for pattern, expression in zip(patterns, self._expressions, strict=True):
            named = expression.groupindex
            if "channel" in named and not plant and "plant" not in named and not dotted:
                raise SettingError(
                    f"topics: topic {echo(pattern)} does not identify the plant: add {{plant}} to it, or set plant"
                )

    def place(self, topic: str) -> tuple[str, str] | None:
        """Return plant and channel of a topic, empty if the message states them; ``None`` if it fits no pattern."""
        try:
            return self._known[topic]
        except KeyError:
            pass
        if len(self._known) >= _REMEMBERED:
            self._known.clear()
        found = next((match for match in (one.fullmatch(topic) for one in self._expressions) if match), None)
        parts = found.groupdict() if found else {}
        self._known[topic] = (parts.get("plant", self._plant), parts.get("channel", "")) if found else None
        return self._known[topic]


def _pattern(pattern: str) -> tuple[str, re.Pattern[str]]:
    """Return the subscription for a broker, and the expression that finds the named parts."""
    levels = pattern.split("/")
    if pattern.startswith(("$", "/$")) or "\0" in pattern or len(pattern.encode()) > 65_535:
        raise SettingError(
            f"topics: {echo(pattern)}: topics that begin with $ are the broker's; those that receivers share "
            "would bring this one a part of each plant's samples only"
        )
    _check_names(pattern, levels)
    filters, expressions = [], []
    for k, level in enumerate(levels):
        rest = _PART.sub("", level)
        if level == "#" and k == len(levels) - 1 and k > 0:
            filters.append("#")
            expressions[-1] += "(?:/.*)?"
            continue
        if any(sign in rest for sign in "{}#") or ("+" in rest and level != "+"):
            raise SettingError(f"topics: {echo(pattern)}: + stands for a whole level, # for all levels at the end")
        filters.append("+" if level == "+" or _PART.search(level) else level)
        expressions.append("[^/]*" if level == "+" else _expression(level))
    return "/".join(filters), re.compile("/".join(expressions), re.DOTALL)


def _check_names(pattern: str, levels: Sequence[str]) -> None:
    names = _PART.findall(pattern)
    if not set(names) <= {"plant", "channel"} or len(set(names)) < len(names):
        raise SettingError(f"topics: {echo(pattern)}: the named parts are {{plant}} and {{channel}}, once each")
    if any(len(_PART.findall(level)) > 1 for level in levels):
        raise SettingError(f"topics: {echo(pattern)}: one named part to a level")


def _dotted(pattern: str) -> tuple[str, re.Pattern[str]]:
    """Return the subscription for Kafka, and the expression that finds the named parts."""
    _check_names(pattern, pattern.split("."))
    if not _KAFKA.fullmatch(_PART.sub("x", pattern)):
        raise SettingError(f"topics: {echo(pattern)}: topics of Kafka have letters, digits, dots, - and _, up to 249")
    expression = re.compile(_PART.sub(r"(?P<\1>[^.]+)", pattern.replace(".", "[.]")))
    named = _PART.search(pattern)
    return (f"^{_PART.sub('[^.]+', pattern.replace('.', '[.]'))}$" if named else pattern), expression


def _expression(level: str) -> str:
    before, *named = _PART.split(level)
    return re.escape(before) + (f"(?P<{named[0]}>[^/]+){re.escape(named[1])}" if named else "")


__all__ = ["Topics"]
