from residua.validate.campaign_result import (
    Campaign as Campaign,
    CaseFacts as CaseFacts,
    Comparison as Comparison,
    PairedCase as PairedCase,
)
from residua.validate.campaigns import campaign as campaign
from residua.validate.delays import Delays as Delays
from residua.validate.detectability import Detectability as Detectability, SmallestFault as SmallestFault
from residua.validate.figure_table import FigureTable as FigureTable
from residua.validate.intervals import Estimate as Estimate
from residua.validate.noise import (
    NoiseModel as NoiseModel,
    Resampled as Resampled,
    coloured as coloured,
    heavy_tailed as heavy_tailed,
    resampled as resampled,
    white as white,
)
from residua.validate.runs import RunFigures as RunFigures
from residua.validate.scenario import Scenario as Scenario, load_scenarios as load_scenarios
from residua.validate.separation import Roc as Roc
from residua.validate.shapes import (
    Shape as Shape,
    drift as drift,
    intermittent as intermittent,
    loss_of_effectiveness as loss_of_effectiveness,
    noise_growth as noise_growth,
    oscillation as oscillation,
    ramp as ramp,
    step as step,
    stuck_at as stuck_at,
)
from residua.validate.size_fit import DetectionProbability as DetectionProbability
from residua.validate.tuning import Tuning as Tuning, TuningCandidate as TuningCandidate, tune as tune
