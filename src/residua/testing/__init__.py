"""Checks for your own residual generators, tests and isolations."""

from residua.facade import hand_on

hand_on(__name__)
