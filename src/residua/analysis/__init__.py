"""Detectability and isolability of faults, before any design."""

from residua.facade import hand_on

hand_on(__name__)
