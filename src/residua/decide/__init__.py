"""Tests and isolations, from residuals to alarms and named faults; one file each."""

from residua.facade import hand_on

hand_on(__name__)
