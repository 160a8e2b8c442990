"""Errors raised by residua; each is a builtin exception too, so that callers need not import them."""

from __future__ import annotations

from residua.visible import visible


class ResiduaError(Exception):
    """Base of every error that residua raises deliberately.

    Names and cells of files are part of many messages: control characters in them are shown, not sent to a terminal.
    """

    def __str__(self) -> str:
        return visible(super().__str__())


class ModelError(ResiduaError, ValueError):
    """A malformed system or plant: shapes, names, non-finite entries."""


class DesignError(ResiduaError, ValueError):
    """A design that does not exist for this plant; the message names the condition and the numbers."""


class NoCertificateError(DesignError):
    """A bound or promise over an uncertainty set that was not proved: it may hold, and narrower sets may have one."""


class AccuracyError(ResiduaError, ArithmeticError):
    """A computed result failed its own check."""


class DataError(ResiduaError, ValueError):
    """A recording that cannot be used as it is: columns, times, lengths."""


class FileFormatError(ResiduaError, ValueError):
    """A plant file or a saved design that cannot be read; the message points at the entry."""


class SettingError(ResiduaError, ValueError):
    """An invalid option; the message has its name, the expected value, and the actual one."""


class NotFittedError(ResiduaError, RuntimeError):
    """A monitor that needs thresholds from fault-free data was run before it had them."""


class MissingExtraError(ResiduaError, ImportError):
    """A missing optional dependency; the message names the extra to install."""


def missing_extra(package: str, extra: str) -> MissingExtraError:
    """Return the error for a missing optional dependency.

    Parameters
    ----------
    package : str
        The package that could not be imported.
    extra : str
        The extra of residua that brings it.

    Returns
    -------
    MissingExtraError
    """
    return MissingExtraError(f"this needs the package {package!r}: pip install 'residua[{extra}]'")


def __dir__() -> list[str]:
    return __all__


__all__ = [
    "AccuracyError",
    "DataError",
    "DesignError",
    "FileFormatError",
    "MissingExtraError",
    "ModelError",
    "NoCertificateError",
    "NotFittedError",
    "ResiduaError",
    "SettingError",
]
