"""Tests and isolations, from residuals to alarms and named faults; one file each."""

from typing import TYPE_CHECKING

from residua.facade import hand_on

if TYPE_CHECKING:
    from residua.decide.adaptive import Adaptive
    from residua.decide.alarm import Alarm, Candidate
    from residua.decide.by_channel import ByChannel
    from residua.decide.calibrated_test import calibrated_test
    from residua.decide.channel_relations import ChannelRelations
    from residua.decide.chi_squared import ChiSquared
    from residua.decide.consistency import ConsistentFault, Explanation, code_likelihoods, consistent_faults
    from residua.decide.cusum import CUSUM
    from residua.decide.directional import Directional, correlation, projection_distance
    from residua.decide.ewma import EWMA
    from residua.decide.glr import GLR
    from residua.decide.hitting_sets import HittingSet, HittingSets, minimal_hitting_sets
    from residua.decide.isolation import Isolation, IsolationSettings, Named, Scores, Seen
    from residua.decide.kinds import register
    from residua.decide.likelihood import Likelihood
    from residua.decide.matched import Matched
    from residua.decide.matched_hold import Match
    from residua.decide.model_errors import OutputError
    from residua.decide.moderated_variances import ModeratedVariances, moderated_variances
    from residua.decide.multiscale_ewma import MultiscaleEWMA
    from residua.decide.norm_threshold import NormThreshold
    from residua.decide.page_hinkley import PageHinkley
    from residua.decide.peak_threshold import PeakThreshold, peak_over_window
    from residua.decide.persistence import AlarmRuns, run_alarm
    from residua.decide.residual_findings import Finding, ResidualFacts, ResidualReport
    from residua.decide.sprt import SPRT
    from residua.decide.statement import Statement
    from residua.decide.structured import CodeReading, CodeTest, Structured, read_code, read_codes
    from residua.decide.test import Block, FaultFreeRun, ResidualTest, Tested, TestSettings, Watched
    from residua.decide.whitening import whitening_matrix
    from residua.decide.window import WindowState, empty_window, moving_sum
    from residua.decide.word import Word
    from residua.monitor.residual_report import residual_report
    from residua.validate.detectability import detectability

__all__ = [
    "CUSUM",
    "EWMA",
    "GLR",
    "SPRT",
    "Adaptive",
    "Alarm",
    "AlarmRuns",
    "Block",
    "ByChannel",
    "Candidate",
    "ChannelRelations",
    "ChiSquared",
    "CodeReading",
    "CodeTest",
    "ConsistentFault",
    "Directional",
    "Explanation",
    "FaultFreeRun",
    "Finding",
    "HittingSet",
    "HittingSets",
    "Isolation",
    "IsolationSettings",
    "Likelihood",
    "Match",
    "Matched",
    "ModeratedVariances",
    "MultiscaleEWMA",
    "Named",
    "NormThreshold",
    "OutputError",
    "PageHinkley",
    "PeakThreshold",
    "ResidualFacts",
    "ResidualReport",
    "ResidualTest",
    "Scores",
    "Seen",
    "Statement",
    "Structured",
    "TestSettings",
    "Tested",
    "Watched",
    "WindowState",
    "Word",
    "calibrated_test",
    "code_likelihoods",
    "consistent_faults",
    "correlation",
    "detectability",
    "empty_window",
    "minimal_hitting_sets",
    "moderated_variances",
    "moving_sum",
    "peak_over_window",
    "projection_distance",
    "read_code",
    "read_codes",
    "register",
    "residual_report",
    "run_alarm",
    "whitening_matrix",
]

hand_on(
    __name__,
    {
        "residua.decide.adaptive": ("Adaptive",),
        "residua.decide.alarm": ("Alarm", "Candidate"),
        "residua.decide.by_channel": ("ByChannel",),
        "residua.decide.calibrated_test": ("calibrated_test",),
        "residua.decide.channel_relations": ("ChannelRelations",),
        "residua.decide.chi_squared": ("ChiSquared",),
        "residua.decide.consistency": ("ConsistentFault", "Explanation", "code_likelihoods", "consistent_faults"),
        "residua.decide.cusum": ("CUSUM",),
        "residua.decide.directional": ("Directional", "correlation", "projection_distance"),
        "residua.decide.ewma": ("EWMA",),
        "residua.decide.glr": ("GLR",),
        "residua.decide.hitting_sets": ("HittingSet", "HittingSets", "minimal_hitting_sets"),
        "residua.decide.isolation": ("Isolation", "IsolationSettings", "Named", "Scores", "Seen"),
        "residua.decide.kinds": ("register",),
        "residua.decide.likelihood": ("Likelihood",),
        "residua.decide.matched": ("Matched",),
        "residua.decide.matched_hold": ("Match",),
        "residua.decide.model_errors": ("OutputError",),
        "residua.decide.moderated_variances": ("ModeratedVariances", "moderated_variances"),
        "residua.decide.multiscale_ewma": ("MultiscaleEWMA",),
        "residua.decide.norm_threshold": ("NormThreshold",),
        "residua.decide.page_hinkley": ("PageHinkley",),
        "residua.decide.peak_threshold": ("PeakThreshold", "peak_over_window"),
        "residua.decide.persistence": ("AlarmRuns", "run_alarm"),
        "residua.decide.residual_findings": ("Finding", "ResidualFacts", "ResidualReport"),
        "residua.decide.sprt": ("SPRT",),
        "residua.decide.statement": ("Statement",),
        "residua.decide.structured": ("CodeReading", "CodeTest", "Structured", "read_code", "read_codes"),
        "residua.decide.test": ("Block", "FaultFreeRun", "ResidualTest", "Tested", "TestSettings", "Watched"),
        "residua.decide.whitening": ("whitening_matrix",),
        "residua.decide.word": ("Word",),
        "residua.decide.window": ("WindowState", "empty_window", "moving_sum"),
        "residua.monitor.residual_report": ("residual_report",),
        "residua.validate.detectability": ("detectability",),
    },
)
