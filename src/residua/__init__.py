"""Model-based fault detection and isolation."""

from residua.plant import Plant

__version__ = "0.1.0"
__all__ = ["Plant"]
