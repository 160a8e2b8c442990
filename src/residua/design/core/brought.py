"""What a design may bring to a monitor besides a residual generator: protocols, which a design has or has not."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Protocol, SupportsFloat, runtime_checkable

from residua.design.core.generator import ResidualGenerator
from residua.errors import ModelError


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
class DesignWithTest(Protocol):
    """A design whose residuals are made for a test of some kind: T2 and Q of principal components, for example."""

    @property
    def test(self) -> Any:
        """Settings of that test, a :class:`residua.decide.TestSettings`."""
        ...


@runtime_checkable
class Watcher(Protocol):
    """A design, such as an observer, that makes a generator when it is asked which residuals are meant."""

    def residual_generator(self) -> ResidualGenerator:
        """Return one."""
        ...


@runtime_checkable
class PartialDesign(Protocol):
    """A design whose members need not all exist."""

    @property
    def failures(self) -> Mapping[str, str]:
        """By name of the member that could not be designed, why."""
        ...


def brings_a_generator(cls: Any) -> bool:
    """Whether what a design function returns is something that a monitor can take: by its class, before any design."""
    if not isinstance(cls, type):
        return False
    declared = {name for base in cls.__mro__ for name in vars(base).get("__annotations__", {})} | set(dir(cls))
    return issubclass(cls, ResidualGenerator) or bool(declared & {"generator", "residual_generator"})


def as_generator(design: Any) -> ResidualGenerator:
    """Return the generator that was handed over, or the ``generator`` of a bank or an estimator.

    Other objects that could give one, such as observers, are refused: which of their residuals is meant is the
    caller's to say.
    """
    if isinstance(design, ResidualGenerator):
        return design
    if isinstance(design, Design) and isinstance(design.generator, ResidualGenerator) and not isinstance(design, type):
        return design.generator
    raise ModelError(
        f"a monitor runs a residual generator, got {type(design).__name__}"
        + ("; use its residual_generator()" if isinstance(design, Watcher) else "")
    )


def for_monitor(made: Any) -> Any:
    """Return what a monitor takes of what a design function returned.

    What makes a generator makes it, and its evidence says which members do not exist; what has one, such as matched
    filters, stays as it is.

    Raises
    ------
    ModelError
        If it is, has and makes no generator.
    """
    if isinstance(made, ResidualGenerator):
        return made
    if isinstance(made, Watcher):
        generator = made.residual_generator()
        missing = made.failures if isinstance(made, PartialDesign) else {}
        notes = tuple(f"no member {name!r}: {reason}" for name, reason in missing.items())
        return replace(generator, evidence=generator.evidence.extended(notes=notes)) if notes else generator
    if isinstance(made, Design):
        return made
    raise ModelError(f"no monitor can take {type(made).__name__}: it is, has and makes no residual generator")
