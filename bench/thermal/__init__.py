"""Dives in world time: the machine decides, the simulated housing warms up by what is on."""
