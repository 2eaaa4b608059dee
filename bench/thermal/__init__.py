"""Dives in world time: the machine decides, and the simulated housing warms up by its devices."""
