"""Whole diagnoses on data that the package makes itself."""

from residua.facade import hand_on

hand_on(__name__)
