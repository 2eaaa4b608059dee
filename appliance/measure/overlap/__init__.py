"""Overlap of two scans, and guidance to where the next one should be taken from."""
