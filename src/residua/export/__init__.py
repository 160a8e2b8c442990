"""Monitors as code for other machines: C99, Functional Mock-up Units, ONNX, IEC 61131-3 Structured Text."""

from typing import TYPE_CHECKING

from residua.facade import hand_on

if TYPE_CHECKING:
    from residua.export.code_folder import to_c, to_structured_text
    from residua.export.fmu import FMU, to_fmu
    from residua.export.onnx import ONNXModel, to_onnx

__all__ = ["FMU", "ONNXModel", "to_c", "to_fmu", "to_onnx", "to_structured_text"]

hand_on(
    __name__,
    {
        "residua.export.code_folder": ("to_c", "to_structured_text"),
        "residua.export.fmu": ("FMU", "to_fmu"),
        "residua.export.onnx": ("ONNXModel", "to_onnx"),
    },
)
