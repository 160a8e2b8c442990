"""Monitors: a residual generator with its decision logic, running on data."""

from residua.facade import hand_on

hand_on(__name__)
