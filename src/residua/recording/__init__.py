"""Measurements: files and frames in, columns by name, the time axis, tables out."""
