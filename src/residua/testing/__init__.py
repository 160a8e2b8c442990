"""Checks for what you add yourself: residual generators, tests and isolations."""

from residua.testing.kinds import check_isolation, check_test
from residua.testing.residual_generator import check_residual_generator

__all__ = ["check_isolation", "check_residual_generator", "check_test"]
