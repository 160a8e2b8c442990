"""Sinks of events: one file for each kind of receiver."""
