"""Sets of systems and plants: uncertain parameters, and loops around them."""
