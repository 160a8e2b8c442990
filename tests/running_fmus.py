"""Functional Mock-up Units, run by FMPy step by step."""

from __future__ import annotations

import ctypes
import importlib
import re
import shutil
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

_KINDS = {
    "2.0": {"real": ("fmi2GetReal", ctypes.c_double), "flag": ("fmi2GetBoolean", ctypes.c_int),
            "count": ("fmi2GetInteger", ctypes.c_int)},
    "3.0": {"real": ("fmi3GetFloat64", ctypes.c_double), "flag": ("fmi3GetBoolean", ctypes.c_bool),
            "count": ("fmi3GetInt32", ctypes.c_int32)},
}  # fmt: skip
_OF_TYPE = {"Real": "real", "Float64": "real", "Boolean": "flag", "Integer": "count", "Int32": "count"}


class RunningFMU:
    """An instance of a unit in step mode; unpacked folders go with it.

    Parameters
    ----------
    path : Path
        The unit, or the folder where another instance has unpacked it.
    start : float
        The time of the first sample.
    hold : bool
        Whether ``hold_inputs`` is set.
    """

    def __init__(self, path: Path, *, start: float = 0.0, hold: bool = False, name: str = "one") -> None:
        fmpy, fmi2, fmi3 = (importlib.import_module(name) for name in ("fmpy", "fmpy.fmi2", "fmpy.fmi3"))
        self._own: Path | None = None
        if path.is_dir():
            self.folder = path
        else:
            self._own = self.folder = Path(tempfile.mkdtemp())
            fmpy.extract(str(path), str(self.folder))
        about = fmpy.read_model_description(str(self.folder))
        self.version = about.fmiVersion
        self.dt = float(about.defaultExperiment.stepSize)
        self.variables = {one.name: one for one in about.modelVariables}
        self.inputs = [one.name for one in about.modelVariables if one.causality == "input"]
        kind = fmi2.FMU2Slave if self.version == "2.0" else fmi3.FMU3Slave
        made: Any = kind(
            guid=about.guid, unzipDirectory=str(self.folder), instanceName=name,
            modelIdentifier=about.coSimulation.modelIdentifier,
        )  # fmt: skip
        self.fmu = made
        self._input_references = [self.reference(name) for name in self.inputs]
        self._places: dict[tuple[str, ...], list[Any]] = {}
        made.instantiate()
        self.setup(start, hold)

    def setup(self, start: float = 0.0, hold: bool = False) -> None:
        """Go from instantiated, or reset, to step mode."""
        self.time, fmu = start, self.fmu
        if hold:
            fmu.setBoolean([self.reference("hold_inputs")], [True])
        if self.version == "2.0":
            fmu.setupExperiment(startTime=start)
            fmu.enterInitializationMode()
        else:
            fmu.enterInitializationMode(startTime=start)
        fmu.exitInitializationMode()

    def reference(self, name: str) -> int:
        return int(self.variables[name].valueReference)

    def set(self, values: NDArray[np.float64]) -> None:
        """Set all inputs."""
        references = self._input_references
        (self.fmu.setReal if self.version == "2.0" else self.fmu.setFloat64)(references, list(map(float, values)))

    def go(self, size: float | None = None) -> None:
        """Take a communication step."""
        size = self.dt if size is None else size
        self.fmu.doStep(currentCommunicationPoint=self.time, communicationStepSize=size)
        self.time += size

    def get(self, *names: str) -> list[float]:
        """Return outputs as numbers."""
        if names not in self._places:
            self._places[names] = [self._block(names, kind) for kind in ("real", "flag", "count")]
        out = [0.0] * len(names)
        for function, places, references, values, more in self._places[names]:
            if places:
                function(self.fmu.component, references, len(places), values, *more)
                for place, value in zip(places, values, strict=True):
                    out[place] = float(value)
        return out

    def _block(self, names: tuple[str, ...], wanted: str) -> tuple[Any, ...]:
        """Return how the variables of a kind are asked for, all at once."""
        function, kind = _KINDS[self.version][wanted]
        places = [k for k, name in enumerate(names) if _OF_TYPE[self.variables[name].type] == wanted]
        references = (ctypes.c_uint32 * len(places))(*(self.reference(names[k]) for k in places))
        more = () if self.version == "2.0" else (len(places),)
        return getattr(self.fmu, function), places, references, (kind * len(places))(), more

    @property
    def columns(self) -> list[str]:
        """What :func:`export_examples.expected` leaves of a decision, by its name here."""
        outputs = [name for name, one in self.variables.items() if one.causality == "output"]
        order = ("residual_", "statistic", "known", "decided", "alarm", "best", "score_", "code_", "answer")
        order = (*order, "part_statistic_", "fired_")
        return [
            name for kind in order for name in outputs if re.fullmatch(rf"{kind}\d+" if kind[-1] == "_" else kind, name)
        ]

    def run(self, data: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return what the unit says after each sample."""
        columns, out = self.columns, []
        for one in data:
            self.set(one)
            self.go()
            out.append(self.get(*columns))
        return np.array(out)

    def close(self) -> None:
        """Free the instance, and the library where it is the last."""
        self.fmu.freeInstance()
        if self._own is not None:
            shutil.rmtree(self._own)
