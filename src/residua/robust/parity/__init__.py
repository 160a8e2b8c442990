"""Parity relations for plants that are not exactly known: families of models, and parameters that drift."""
