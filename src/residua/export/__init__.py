"""Monitors as code for other machines: C99, Functional Mock-up Units, IEC 61131-3 Structured Text."""

from residua.export.code_folder import to_c, to_structured_text
from residua.export.fmu import FMU, to_fmu

__all__ = ["FMU", "to_c", "to_fmu", "to_structured_text"]
