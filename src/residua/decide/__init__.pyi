from residua.decide.adaptive import Adaptive as Adaptive
from residua.decide.alarm import Alarm as Alarm, Candidate as Candidate
from residua.decide.by_channel import ByChannel as ByChannel
from residua.decide.channel_relations import ChannelRelations as ChannelRelations
from residua.decide.chi_squared import ChiSquared as ChiSquared
from residua.decide.code_reading import CodeReading as CodeReading
from residua.decide.cusum import CUSUM as CUSUM
from residua.decide.directional import (
    Directional as Directional,
    correlation as correlation,
    projection_distance as projection_distance,
)
from residua.decide.ewma import EWMA as EWMA
from residua.decide.fired_patterns import (
    ConsistentFault as ConsistentFault,
    Explanation as Explanation,
    HittingSet as HittingSet,
    HittingSets as HittingSets,
    code_likelihoods as code_likelihoods,
    consistent_faults as consistent_faults,
    minimal_hitting_sets as minimal_hitting_sets,
    read_code as read_code,
    read_codes as read_codes,
)
from residua.decide.glr import GLR as GLR
from residua.decide.isolation import (
    Isolation as Isolation,
    IsolationSettings as IsolationSettings,
    Named as Named,
    Scores as Scores,
    Seen as Seen,
)
from residua.decide.kinds import register as register
from residua.decide.likelihood import Likelihood as Likelihood
from residua.decide.matched import Matched as Matched
from residua.decide.matched_recursion import Match as Match
from residua.decide.model_errors import OutputError as OutputError
from residua.decide.moderated_variances import (
    ModeratedVariances as ModeratedVariances,
    moderated_variances as moderated_variances,
)
from residua.decide.multiscale_ewma import MultiscaleEWMA as MultiscaleEWMA
from residua.decide.norm_threshold import NormThreshold as NormThreshold
from residua.decide.page_hinkley import PageHinkley as PageHinkley
from residua.decide.peak_threshold import PeakThreshold as PeakThreshold, peak_over_window as peak_over_window
from residua.decide.persistence import AlarmRuns as AlarmRuns, run_alarm as run_alarm
from residua.decide.residual_findings import (
    Finding as Finding,
    ResidualFacts as ResidualFacts,
    ResidualReport as ResidualReport,
)
from residua.decide.sprt import SPRT as SPRT
from residua.decide.statement import Statement as Statement
from residua.decide.structured import CodeTest as CodeTest, Structured as Structured
from residua.decide.test import (
    Block as Block,
    FaultFreeRun as FaultFreeRun,
    ResidualTest as ResidualTest,
    Tested as Tested,
    TestSettings as TestSettings,
    Watched as Watched,
)
from residua.decide.whitening import whitening_matrix as whitening_matrix
from residua.decide.window import WindowState as WindowState, empty_window as empty_window, moving_sum as moving_sum
from residua.decide.word import Word as Word
from residua.monitor.residual_report import residual_report as residual_report
from residua.validate.detectability import detectability as detectability
