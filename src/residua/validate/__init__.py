"""Campaigns of simulated faults: error rates of a monitor, its delays and the names it gives, with intervals."""

from typing import TYPE_CHECKING

from residua.facade import hand_on

if TYPE_CHECKING:
    from residua.validate.campaign_result import Campaign, CaseFacts, Comparison, PairedCase
    from residua.validate.campaigns import campaign
    from residua.validate.delays import Delays
    from residua.validate.detectability import Detectability, SmallestFault
    from residua.validate.figure_table import FigureTable
    from residua.validate.intervals import Estimate
    from residua.validate.noise import NoiseModel, Resampled, coloured, heavy_tailed, resampled, white
    from residua.validate.runs import RunFigures
    from residua.validate.scenario import Scenario, load_scenarios
    from residua.validate.separation import Roc
    from residua.validate.shapes import (
        Shape,
        drift,
        intermittent,
        loss_of_effectiveness,
        noise_growth,
        oscillation,
        ramp,
        step,
        stuck_at,
    )
    from residua.validate.size_fit import DetectionProbability
    from residua.validate.tuning import Tuning, TuningCandidate, tune

__all__ = [
    "Campaign",
    "CaseFacts",
    "Comparison",
    "Delays",
    "Detectability",
    "DetectionProbability",
    "Estimate",
    "FigureTable",
    "NoiseModel",
    "PairedCase",
    "Resampled",
    "Roc",
    "RunFigures",
    "Scenario",
    "Shape",
    "SmallestFault",
    "Tuning",
    "TuningCandidate",
    "campaign",
    "coloured",
    "drift",
    "heavy_tailed",
    "intermittent",
    "load_scenarios",
    "loss_of_effectiveness",
    "noise_growth",
    "oscillation",
    "ramp",
    "resampled",
    "step",
    "stuck_at",
    "tune",
    "white",
]

hand_on(
    __name__,
    {
        "residua.validate.campaign_result": ("Campaign", "CaseFacts", "Comparison", "PairedCase"),
        "residua.validate.campaigns": ("campaign",),
        "residua.validate.delays": ("Delays",),
        "residua.validate.detectability": ("Detectability", "SmallestFault"),
        "residua.validate.figure_table": ("FigureTable",),
        "residua.validate.intervals": ("Estimate",),
        "residua.validate.noise": ("NoiseModel", "Resampled", "coloured", "heavy_tailed", "resampled", "white"),
        "residua.validate.runs": ("RunFigures",),
        "residua.validate.scenario": ("Scenario", "load_scenarios"),
        "residua.validate.separation": ("Roc",),
        "residua.validate.shapes": (
            "Shape",
            "drift",
            "intermittent",
            "loss_of_effectiveness",
            "noise_growth",
            "oscillation",
            "ramp",
            "step",
            "stuck_at",
        ),
        "residua.validate.size_fit": ("DetectionProbability",),
        "residua.validate.tuning": ("Tuning", "TuningCandidate", "tune"),
    },
)
