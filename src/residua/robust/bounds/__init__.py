"""Bounds of the peak norm and of the gain over all members of an uncertain system."""
