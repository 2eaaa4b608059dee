"""Scan transfer from an instrument to a desk; it deletes no file at either end."""
