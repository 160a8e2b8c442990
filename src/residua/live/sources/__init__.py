"""Sources of data: one file for each protocol."""
