"""Messages of sources, and the readings in them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

#: Bytes of a message at most, and characters of the id of a plant.
LARGEST, LONGEST_ID = 4_000_000, 200


@dataclass(slots=True)
class Message:
    """One message of a source, unchanged.

    Attributes
    ----------
    source : Source
        Which is told when the message is safe: :meth:`residua.live.source.Source.acknowledge`.
    payload : bytes or float
        JSON, as the page "Live sources" describes it; of one channel its value, or JSON with ``t`` and ``value``.
    arrived : float
        When it came, in seconds since 1970: the time of a value that has none.
    plant : str
        The id of the plant, where the topic or the node says it; a message that says another is refused.
    channel : str
        The channel, where a topic or a node has one channel; else empty: the payload names its channels.
    time : float or None
        In seconds, where the protocol says it.
    token : object
        Data with which the source acknowledges it.
    refused : str
        Reason for which the source refuses the message, as a word by which it is counted (``"size"``, ``"topic"``,
        ``"retained"``, ``"null"``): it is dropped, and acknowledged in its turn. Empty: no error so far.
    line : int
        Its number, from 1, where it is a line of text; else 0.
    """

    source: Any
    payload: bytes | float
    arrived: float
    plant: str = ""
    channel: str = ""
    time: float | None = None
    token: Any = None
    refused: str = ""
    line: int = 0
