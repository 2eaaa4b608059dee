"""The verdict ``light``: saturation, modulation, changes of ambient light, and the exposures to try next."""
