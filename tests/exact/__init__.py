"""Exact answers about small plants, in rational arithmetic: the oracles of the campaign. Nothing here uses residua."""
