"""The former place of :mod:`residua.linear.systems.recursion`; it goes with version 0.3."""

import warnings

from residua.linear.systems.recursion import compiled, ordered_product, run_filter

__all__ = ["compiled", "ordered_product", "run_filter"]

warnings.warn(
    "residua.linear.recursion is residua.linear.systems.recursion now; the old name goes with version 0.3",
    DeprecationWarning,
    stacklevel=2,
)
