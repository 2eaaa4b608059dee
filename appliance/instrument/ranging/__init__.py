"""Measures the distance from the laser dots in single live images, and says whether the object is within reach."""
