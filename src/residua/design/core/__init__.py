"""What every design shares: the generator, its internal form, its evidence and its structure."""
