"""Observers: estimates of the state, and the residuals they leave."""
