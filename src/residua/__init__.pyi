from residua import (
    analysis as analysis,
    cluster as cluster,
    decide as decide,
    design as design,
    errors as errors,
    export as export,
    identify as identify,
    library as library,
    linear as linear,
    monitor as monitor,
    plant as plant,
    report as report,
    testing as testing,
    validate as validate,
)
from residua.analysis import coding as coding, diagnosability as diagnosability
from residua.design.observers.general_residual_generator import (
    residual_generator_from_observer as residual_generator_from_observer,
)
from residua.design.suggestion import suggest as suggest
from residua.linear import StateSpace as StateSpace
from residua.monitor import (
    Diagnosis as Diagnosis,
    Fleet as Fleet,
    Learnt as Learnt,
    Monitor as Monitor,
    RegimeMonitor as RegimeMonitor,
    learn as learn,
    read_recording as read_recording,
)
from residua.plant import (
    InputOutputModel as InputOutputModel,
    Plant as Plant,
    UncertainPlant as UncertainPlant,
    load_plant as load_plant,
)

__version__: str
