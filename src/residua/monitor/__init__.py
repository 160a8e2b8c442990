"""A generator with its decision logic, running on data."""

from residua.monitor.diagnosis import Alarm, Candidate, Diagnosis
from residua.monitor.monitor import Decision, Monitor

__all__ = ["Alarm", "Candidate", "Decision", "Diagnosis", "Monitor"]
