"""Owns how scans come from an instrument to a desk: only what is not there, compared byte for byte, nothing deleted at
either end."""
