"""From the frames of one camera to pattern coordinates, modulation and a reason where there are none."""
