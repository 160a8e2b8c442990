"""Parity relations: polynomial equations between inputs and outputs that hold while nothing fails."""
