"""Ready-made plants, one file per paper or benchmark."""

from typing import TYPE_CHECKING

from residua.facade import hand_on

if TYPE_CHECKING:
    from residua.library.degrading_jet_engine import (
        degrading_jet_engine,
        degrading_jet_engine_controller,
        degrading_jet_engine_corner,
        simulate_degrading_jet_engine,
    )
    from residua.library.gertler import gertler
    from residua.library.jet_engine import (
        E_HAT,
        jet_engine,
        jet_engine_rate,
        jet_engine_steady_state,
        simulate_jet_engine,
    )
    from residua.library.ladder_circuit import ladder_circuit
    from residua.library.simulation import SimulatedRecording, drift
    from residua.library.three_tank import three_tank, three_tank_fault, three_tank_rate
    from residua.library.three_tank_simulation import simulate_three_tank
    from residua.library.twardy import twardy
    from residua.library.vtol import vtol

__all__ = [
    "E_HAT",
    "SimulatedRecording",
    "degrading_jet_engine",
    "degrading_jet_engine_controller",
    "degrading_jet_engine_corner",
    "drift",
    "gertler",
    "jet_engine",
    "jet_engine_rate",
    "jet_engine_steady_state",
    "ladder_circuit",
    "simulate_degrading_jet_engine",
    "simulate_jet_engine",
    "simulate_three_tank",
    "three_tank",
    "three_tank_fault",
    "three_tank_rate",
    "twardy",
    "vtol",
]

hand_on(
    __name__,
    {
        "residua.library.degrading_jet_engine": (
            "degrading_jet_engine",
            "degrading_jet_engine_controller",
            "degrading_jet_engine_corner",
            "simulate_degrading_jet_engine",
        ),
        "residua.library.gertler": ("gertler",),
        "residua.library.jet_engine": (
            "E_HAT",
            "jet_engine",
            "jet_engine_rate",
            "jet_engine_steady_state",
            "simulate_jet_engine",
        ),
        "residua.library.ladder_circuit": ("ladder_circuit",),
        "residua.library.simulation": ("SimulatedRecording", "drift"),
        "residua.library.three_tank": ("three_tank", "three_tank_fault", "three_tank_rate"),
        "residua.library.three_tank_simulation": ("simulate_three_tank",),
        "residua.library.twardy": ("twardy",),
        "residua.library.vtol": ("vtol",),
    },
)
