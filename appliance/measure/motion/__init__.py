"""Rigid motion of the hands during a sequence: estimated from the scan itself and taken out of its points."""
