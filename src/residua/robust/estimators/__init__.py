"""Robust l1 estimators: the search of their gains, and thresholds that hold over the whole set."""
