"""Ranging: the distance of the object from the laser dots in single live images."""
