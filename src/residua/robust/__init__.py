"""Uncertain plants: sets, bounds, estimators that hold over a set, and parity relations that hold for a family."""
