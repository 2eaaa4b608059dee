"""Merging measured: pairs of views and whole rows of scans of the simulated world, against where they were taken from."""
