from residua.library.degrading_jet_engine import (
    degrading_jet_engine as degrading_jet_engine,
    degrading_jet_engine_controller as degrading_jet_engine_controller,
    degrading_jet_engine_corner as degrading_jet_engine_corner,
    simulate_degrading_jet_engine as simulate_degrading_jet_engine,
)
from residua.library.gertler import gertler as gertler
from residua.library.jet_engine import (
    E_HAT as E_HAT,
    jet_engine as jet_engine,
    jet_engine_rate as jet_engine_rate,
    jet_engine_steady_state as jet_engine_steady_state,
    simulate_jet_engine as simulate_jet_engine,
)
from residua.library.ladder_circuit import ladder_circuit as ladder_circuit
from residua.library.simulation import SimulatedRecording as SimulatedRecording, drift as drift
from residua.library.three_tank import (
    three_tank as three_tank,
    three_tank_fault as three_tank_fault,
    three_tank_rate as three_tank_rate,
)
from residua.library.three_tank_simulation import simulate_three_tank as simulate_three_tank
from residua.library.twardy import twardy as twardy
from residua.library.vtol import vtol as vtol
