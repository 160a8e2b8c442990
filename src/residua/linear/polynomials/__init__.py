"""Polynomial matrices and pencils, their bases and null spaces."""
