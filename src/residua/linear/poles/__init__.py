"""Eigenvalues, zeros, and gains that place poles."""
