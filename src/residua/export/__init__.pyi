from residua.export.code_folder import to_c as to_c, to_structured_text as to_structured_text
from residua.export.fmu import FMU as FMU, to_fmu as to_fmu
from residua.export.onnx import ONNXModel as ONNXModel, to_onnx as to_onnx
