from residua.demos.outcome import Outcome as Outcome
