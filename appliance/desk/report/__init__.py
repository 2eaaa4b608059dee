"""Report for a client: one HTML page with an interactive surface, its deviations, and its provenance."""
