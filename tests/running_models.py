"""ONNX models, run by ONNX Runtime block by block."""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import Any

import numpy as np


class RunningModel:
    """A model in ONNX Runtime, with the state after the last block."""

    def __init__(self, path: Path) -> None:
        runtime = importlib.import_module("onnxruntime")
        options = runtime.SessionOptions()
        options.intra_op_num_threads = 1
        self.session = runtime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])
        self.types = {one.name: np.float64 if "double" in one.type else np.float32 for one in self.session.get_inputs()}
        self.shapes = {one.name: one.shape for one in self.session.get_inputs()}
        self.outputs = [one.name for one in self.session.get_outputs()]
        self.reset()

    def reset(self) -> None:
        real = self.types["state"]
        self.state = {
            "state": np.zeros(self.shapes["state"], real), "counts": np.zeros(self.shapes["counts"], np.int64)
        }  # fmt: skip

    def run(self, data: np.ndarray) -> np.ndarray:
        """Return what the model says of a block: as :func:`export_examples.expected` has it."""
        inputs = self.shapes["u"][1] if "u" in self.shapes else 0
        feed: dict[str, Any] = self.state | {"y": data[:, inputs:].astype(self.types["y"])}
        if inputs:
            feed["u"] = data[:, :inputs].astype(self.types["u"])
        out = dict(zip(self.outputs, self.session.run(None, feed), strict=True))
        self.state = {"state": out["next_state"], "counts": out["next_counts"]}
        order = ("residual", "statistic", "known", "decided", "alarm", "best", "score", "code", "answer")
        order = (*order, "part_statistic", "fired")
        return np.hstack([out[name].astype(float).reshape(len(data), -1) for name in order if name in out])
