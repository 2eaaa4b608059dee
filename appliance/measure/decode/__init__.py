"""Decoding: the frames of one camera become pattern coordinates, modulation, and a reason where there are none."""
