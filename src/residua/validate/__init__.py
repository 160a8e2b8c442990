"""Campaigns of simulated faults: error rates of a monitor, its delays and the names it gives, with intervals."""

from residua.facade import hand_on

hand_on(__name__)
