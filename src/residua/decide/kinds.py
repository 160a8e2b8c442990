"""Registry of the kinds of tests and isolations, used by files and by ``isolate="auto"``."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeVar

from residua.decide.adaptive import Adaptive
from residua.decide.by_channel import ByChannel
from residua.decide.channel_relations import ChannelRelations
from residua.decide.chi_squared import ChiSquared
from residua.decide.cusum import CUSUM
from residua.decide.directional import Directional
from residua.decide.ewma import EWMA
from residua.decide.glr import GLR
from residua.decide.isolation import IsolationSettings, NoIsolation
from residua.decide.likelihood import Likelihood
from residua.decide.matched import Matched
from residua.decide.multiscale_ewma import MultiscaleEWMA
from residua.decide.norm_threshold import NormThreshold
from residua.decide.page_hinkley import PageHinkley
from residua.decide.peak_threshold import PeakThreshold
from residua.decide.sprt import SPRT
from residua.decide.structured import Structured
from residua.decide.test import TestSettings
from residua.errors import FileFormatError, SettingError
from residua.records import table_in, text_in
from residua.visible import echo

#: By the mark that files know them by; for ``isolate="auto"`` the last one counts that offers to read a design.
TESTS: dict[str, type[TestSettings]] = {
    cls.kind: cls
    for cls in (
        *(MultiscaleEWMA, NormThreshold, PeakThreshold, Adaptive, ChiSquared, EWMA, CUSUM, GLR, SPRT, PageHinkley),
        ChannelRelations,
    )
}
ISOLATIONS: dict[str, type[IsolationSettings]] = {
    cls.kind: cls for cls in (Directional, Structured, Matched, Likelihood, ByChannel)
}

Kind = TypeVar("Kind", bound=type[TestSettings] | type[IsolationSettings])


def register(cls: Kind) -> Kind:
    """Register a test or an isolation of your own, so that monitors with it can be loaded from files.

    Use it as a decorator of the settings.

    Parameters
    ----------
    cls : type
        A subclass of :class:`residua.decide.TestSettings` or :class:`residua.decide.IsolationSettings` with a ``kind``
        that no other has.

    Returns
    -------
    type
        The same.

    Raises
    ------
    SettingError
        If it is neither, or another one has its kind already.

    Examples
    --------
    >>> from residua.decide import NormThreshold, register
    >>> register(NormThreshold).kind
    'norm'
    """
    known: dict[str, Any]
    if isinstance(cls, type) and issubclass(cls, TestSettings):
        known = TESTS
    elif isinstance(cls, type) and issubclass(cls, IsolationSettings):
        known = ISOLATIONS
    else:
        raise SettingError(f"register takes a subclass of TestSettings or IsolationSettings, got {echo(cls)}")
    try:
        kind = cls.kind
    except AttributeError:
        kind = ""
    if not isinstance(kind, str) or not kind:
        raise SettingError(f"{cls.__name__} must have a kind, the text that files know it by")
    other = known.get(kind, cls)
    if other is not cls and (other.__module__, other.__qualname__) != (cls.__module__, cls.__qualname__):
        raise SettingError(f"the kind {kind!r} is that of {other.__module__}.{other.__qualname__}: take another")
    known[kind] = cls  # a module that is imported anew takes its own place
    return cls


def settings_out(settings: TestSettings | IsolationSettings) -> dict[str, Any]:
    """Return settings as a record, marked with their kind."""
    return {"kind": settings.kind} | settings.to_record()


def read_test(value: Any, where: str) -> TestSettings:
    """Return the settings of a test from a record."""
    cls, content = _kind_in(value, where, TESTS)
    return cls.from_record(content, where)


def read_isolation(value: Any, where: str) -> IsolationSettings:
    """Return the settings of an isolation from a record; of none from ``None``."""
    if value is None:
        return NoIsolation()
    cls, content = _kind_in(value, where, ISOLATIONS)
    return cls.from_record(content, where)


def _kind_in(value: Any, where: str, known: Mapping[str, type[Any]]) -> tuple[type[Any], dict[str, Any]]:
    """Return the class that a record is marked with, and the rest of the record."""
    content = table_in(value, where)
    if "kind" not in content:
        raise FileFormatError(f"the entry '{where}.kind' is missing")
    kind = text_in(content.pop("kind"), f"{where}.kind")
    if kind not in known:
        raise FileFormatError(
            f"{where}.kind: expected one of {', '.join(known)}, got {echo(kind)}; import the module of one of your own "
            "before its monitors are loaded"
        )
    return known[kind], content


__all__ = ["ISOLATIONS", "TESTS", "read_isolation", "read_test", "register", "settings_out"]
