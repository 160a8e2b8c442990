"""Checks for your own residual generators, tests and isolations."""

from typing import TYPE_CHECKING

from residua.facade import hand_on

if TYPE_CHECKING:
    from residua.testing.kinds import check_isolation, check_test
    from residua.testing.residual_generator import check_residual_generator

__all__ = ["check_isolation", "check_residual_generator", "check_test"]

hand_on(
    __name__,
    {
        "residua.testing.kinds": ("check_isolation", "check_test"),
        "residua.testing.residual_generator": ("check_residual_generator",),
    },
)
