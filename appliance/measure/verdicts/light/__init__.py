"""The verdict on light: saturation, modulation, changes of ambient light, and the exposures to try next."""
