"""From residuals to alarms and named faults: one test or isolation, one file."""

from typing import TYPE_CHECKING

from residua.facade import hand_on

if TYPE_CHECKING:
    from residua.decide.adaptive import Adaptive, AdaptiveTest
    from residua.decide.alarm import Alarm, Candidate
    from residua.decide.by_channel import ByChannel, ChannelNames
    from residua.decide.channel_relations import ChannelRelations, ChannelRelationsTest
    from residua.decide.chi_squared import ChiSquared, ChiSquaredTest
    from residua.decide.consistency import ConsistentFault, Explanation, code_likelihoods, consistent_faults
    from residua.decide.cusum import CUSUM, CUSUMTest
    from residua.decide.directional import Directional, DirectionTest, correlation, projection_distance
    from residua.decide.ewma import EWMA, EWMATest
    from residua.decide.glr import GLR, DirectedGLRTest, GLRTest
    from residua.decide.hitting_sets import HittingSet, HittingSets, minimal_hitting_sets
    from residua.decide.isolation import Isolation, IsolationSettings, Named, Scores, Seen
    from residua.decide.kinds import register
    from residua.decide.likelihood import Likelihood, LikelihoodNames
    from residua.decide.matched import Matched
    from residua.decide.matched_hold import Match
    from residua.decide.matched_level import LikelihoodTest
    from residua.decide.matched_responses import MatchedTest
    from residua.decide.member_thresholds import BankTest, GroupTest
    from residua.decide.model_errors import OutputError
    from residua.decide.moderated_variances import ModeratedVariances, moderated_variances
    from residua.decide.multiscale_ewma import MultiscaleEWMA, MultiscaleEWMATest
    from residua.decide.norm_threshold import NormTest, NormThreshold
    from residua.decide.page_hinkley import PageHinkley, PageHinkleyTest
    from residua.decide.peak_threshold import PeakThreshold, peak_over_window
    from residua.decide.persistence import AlarmRuns, run_alarm
    from residua.decide.residual_findings import Finding, ResidualFacts, ResidualReport
    from residua.decide.sprt import SPRT, SPRTTest
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
    "AdaptiveTest",
    "Alarm",
    "AlarmRuns",
    "BankTest",
    "Block",
    "ByChannel",
    "CUSUMTest",
    "Candidate",
    "ChannelNames",
    "ChannelRelations",
    "ChannelRelationsTest",
    "ChiSquared",
    "ChiSquaredTest",
    "CodeReading",
    "CodeTest",
    "ConsistentFault",
    "DirectedGLRTest",
    "DirectionTest",
    "Directional",
    "EWMATest",
    "Explanation",
    "FaultFreeRun",
    "Finding",
    "GLRTest",
    "GroupTest",
    "HittingSet",
    "HittingSets",
    "Isolation",
    "IsolationSettings",
    "Likelihood",
    "LikelihoodNames",
    "LikelihoodTest",
    "Match",
    "Matched",
    "MatchedTest",
    "ModeratedVariances",
    "MultiscaleEWMA",
    "MultiscaleEWMATest",
    "Named",
    "NormTest",
    "NormThreshold",
    "OutputError",
    "PageHinkley",
    "PageHinkleyTest",
    "PeakThreshold",
    "ResidualFacts",
    "ResidualReport",
    "ResidualTest",
    "SPRTTest",
    "Scores",
    "Seen",
    "Statement",
    "Structured",
    "TestSettings",
    "Tested",
    "Watched",
    "WindowState",
    "Word",
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
        "residua.decide.adaptive": ("Adaptive", "AdaptiveTest"),
        "residua.decide.alarm": ("Alarm", "Candidate"),
        "residua.decide.by_channel": ("ByChannel", "ChannelNames"),
        "residua.decide.channel_relations": ("ChannelRelations", "ChannelRelationsTest"),
        "residua.decide.chi_squared": ("ChiSquared", "ChiSquaredTest"),
        "residua.decide.consistency": ("ConsistentFault", "Explanation", "code_likelihoods", "consistent_faults"),
        "residua.decide.cusum": ("CUSUM", "CUSUMTest"),
        "residua.decide.directional": ("Directional", "DirectionTest", "correlation", "projection_distance"),
        "residua.decide.ewma": ("EWMA", "EWMATest"),
        "residua.decide.glr": ("GLR", "DirectedGLRTest", "GLRTest"),
        "residua.decide.hitting_sets": ("HittingSet", "HittingSets", "minimal_hitting_sets"),
        "residua.decide.isolation": ("Isolation", "IsolationSettings", "Named", "Scores", "Seen"),
        "residua.decide.kinds": ("register",),
        "residua.decide.likelihood": ("Likelihood", "LikelihoodNames"),
        "residua.decide.matched": ("Matched",),
        "residua.decide.matched_hold": ("Match",),
        "residua.decide.matched_level": ("LikelihoodTest",),
        "residua.decide.matched_responses": ("MatchedTest",),
        "residua.decide.member_thresholds": ("BankTest", "GroupTest"),
        "residua.decide.model_errors": ("OutputError",),
        "residua.decide.moderated_variances": ("ModeratedVariances", "moderated_variances"),
        "residua.decide.multiscale_ewma": ("MultiscaleEWMA", "MultiscaleEWMATest"),
        "residua.decide.norm_threshold": ("NormTest", "NormThreshold"),
        "residua.decide.page_hinkley": ("PageHinkley", "PageHinkleyTest"),
        "residua.decide.peak_threshold": ("PeakThreshold", "peak_over_window"),
        "residua.decide.persistence": ("AlarmRuns", "run_alarm"),
        "residua.decide.residual_findings": ("Finding", "ResidualFacts", "ResidualReport"),
        "residua.decide.sprt": ("SPRT", "SPRTTest"),
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
