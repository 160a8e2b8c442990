from residua.decide.alarm import (
    Alarm as Alarm,
    Beginning as Beginning,
    Candidate as Candidate,
    LearntMatch as LearntMatch,
    PresentFault as PresentFault,
    Size as Size,
)
from residua.monitor.decision import Decision as Decision
from residua.monitor.diagnosis import Diagnosis as Diagnosis
from residua.monitor.fault_learning import LearntFaults as LearntFaults, LearntRow as LearntRow
from residua.monitor.fleet import Fleet as Fleet
from residua.monitor.fleet_block import AlarmEvent as AlarmEvent, FleetAlarm as FleetAlarm, Tick as Tick
from residua.monitor.learning import Learnt as Learnt, Tried as Tried, learn as learn
from residua.monitor.monitor import Monitor as Monitor
from residua.monitor.regime_monitor import (
    RegimeAlarm as RegimeAlarm,
    RegimeDiagnosis as RegimeDiagnosis,
    RegimeMonitor as RegimeMonitor,
)
from residua.monitor.running import Decisions as Decisions
from residua.recording.recording import (
    Recording as Recording,
    read_recording as read_recording,
    recording_from_frame as recording_from_frame,
)
from residua.recording.table_writer import write_table as write_table
