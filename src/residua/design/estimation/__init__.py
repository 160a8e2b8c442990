"""Estimates of faults, and control that makes up for them."""
