"""The common base of all designs: the generator, its internal form, its evidence and its structure."""
