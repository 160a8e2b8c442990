"""Monitors: a residual generator with its decision logic, running on data."""

from typing import TYPE_CHECKING

from residua.facade import hand_on

if TYPE_CHECKING:
    from residua.decide.alarm import Alarm, Beginning, Candidate, LearntMatch, PresentFault, Size
    from residua.monitor.decision import Decision
    from residua.monitor.diagnosis import Diagnosis
    from residua.monitor.fault_learning import LearntFaults, LearntRow
    from residua.monitor.fleet import Fleet
    from residua.monitor.fleet_block import AlarmEvent, FleetAlarm, Tick
    from residua.monitor.learning import Learnt, Tried, learn
    from residua.monitor.monitor import Monitor
    from residua.monitor.regime_monitor import RegimeAlarm, RegimeDiagnosis, RegimeMonitor
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
    "Learnt",
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
    "Tried",
    "learn",
    "read_recording",
    "recording_from_frame",
    "write_table",
]

hand_on(
    __name__,
    {
        "residua.decide.alarm": ("Alarm", "Beginning", "Candidate", "LearntMatch", "PresentFault", "Size"),
        "residua.monitor.decision": ("Decision",),
        "residua.monitor.diagnosis": ("Diagnosis",),
        "residua.monitor.fault_learning": ("LearntFaults", "LearntRow"),
        "residua.monitor.fleet": ("Fleet",),
        "residua.monitor.fleet_block": ("AlarmEvent", "FleetAlarm", "Tick"),
        "residua.monitor.learning": ("Learnt", "Tried", "learn"),
        "residua.monitor.monitor": ("Monitor",),
        "residua.monitor.regime_monitor": ("RegimeAlarm", "RegimeDiagnosis", "RegimeMonitor"),
        "residua.monitor.running": ("Decisions",),
        "residua.recording.recording": ("Recording", "read_recording", "recording_from_frame"),
        "residua.recording.table_writer": ("write_table",),
    },
)
