"""Photons through turbid water, against the simulator's veil."""
