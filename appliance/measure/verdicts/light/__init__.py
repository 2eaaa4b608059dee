"""The verdict ``light``: saturation, modulation, changing ambient light; and proposed exposures."""
