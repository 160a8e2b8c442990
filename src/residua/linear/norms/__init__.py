"""Norms of stable systems: from peak to peak, over frequency, and to white noise."""
