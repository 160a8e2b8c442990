from residua.analysis import coding as coding
from residua.analysis.diagnosability import Diagnosability as Diagnosability, diagnosability as diagnosability
from residua.analysis.existence import (
    UnknownInputExistence as UnknownInputExistence,
    unknown_input_observer_existence as unknown_input_observer_existence,
)
