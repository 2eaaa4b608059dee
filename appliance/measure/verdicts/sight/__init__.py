"""The verdict ``sight``: visible fringes, light, and the distance of the object."""
