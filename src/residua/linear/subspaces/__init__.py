"""Ranks and subspaces: what is observable, reachable, or hidden from an output."""
