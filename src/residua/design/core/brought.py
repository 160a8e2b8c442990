"""What a design may bring to a monitor besides a residual generator: protocols, which a design has or has not."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol, SupportsFloat, runtime_checkable

from residua.design.core.generator import ResidualGenerator


@runtime_checkable
class Design(Protocol):
    """A design that is no generator itself, such as a bank or an estimator: it has one."""

    @property
    def generator(self) -> ResidualGenerator:
        """What runs."""
        ...


@runtime_checkable
class CertifiedDesign(Protocol):
    """A design that has proved thresholds: no fault-free residual of a member exceeds that of the member."""

    @property
    def thresholds(self) -> Mapping[str, SupportsFloat]:
        """By name of the member."""
        ...


@runtime_checkable
class BoundedDesign(Protocol):
    """A design that is certain of what each member answers to, over a whole uncertainty set."""

    @property
    def member_bounds(self) -> Mapping[str, tuple[float, float, Mapping[str, float]]]:
        """By name of the member, the bound of what disturbances cause, the least response to its own fault of size one,
        and the bounds of what other faults of size one cause.
        """
        ...


@runtime_checkable
class Watcher(Protocol):
    """A design, such as an observer, that makes a generator when it is asked which residuals are meant."""

    def residual_generator(self) -> ResidualGenerator:
        """Return one."""
        ...
