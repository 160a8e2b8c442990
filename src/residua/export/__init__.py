"""Monitors as code for other machines: C99, Functional Mock-up Units, ONNX, IEC 61131-3 Structured Text."""

from residua.facade import hand_on

hand_on(__name__)
