"""Monitors as code for other machines: C99, Functional Mock-up Units, IEC 61131-3 Structured Text."""

from residua.export.code_folder import to_c, to_structured_text

__all__ = ["to_c", "to_structured_text"]
