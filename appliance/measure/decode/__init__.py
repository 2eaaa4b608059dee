"""Decoding: pattern coordinates, modulation, and reasons for missing ones, from one camera's frames."""
