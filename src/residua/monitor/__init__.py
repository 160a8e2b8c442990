"""A generator with its decision logic, running on data."""

from residua.decide.alarm import Alarm, Beginning, Candidate, LearntMatch, PresentFault, Size
from residua.monitor.decision import Decision
from residua.monitor.diagnosis import Diagnosis
from residua.monitor.fault_learning import LearntFaults, LearntRow
from residua.monitor.fleet import Fleet
from residua.monitor.fleet_block import AlarmEvent, FleetAlarm, Tick
from residua.monitor.monitor import Monitor
from residua.monitor.regime_diagnosis import RegimeAlarm, RegimeDiagnosis
from residua.monitor.regime_monitor import RegimeMonitor
from residua.monitor.running import Decisions
from residua.recording.recording import Recording, read_recording, recording_from_frame
from residua.recording.table_writer import write_table

__all__ = [
    "Alarm",
    "AlarmEvent",
    "Beginning",
    "Candidate",
    "Decision",
    "Decisions",
    "Diagnosis",
    "Fleet",
    "FleetAlarm",
    "LearntFaults",
    "LearntMatch",
    "LearntRow",
    "Monitor",
    "PresentFault",
    "Recording",
    "RegimeAlarm",
    "RegimeDiagnosis",
    "RegimeMonitor",
    "Size",
    "Tick",
    "read_recording",
    "recording_from_frame",
    "write_table",
]
