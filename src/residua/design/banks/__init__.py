"""Banks: residuals that ignore chosen faults, one by one and together."""
