"""Measures a new instrument before its first scan: light over time, response, raster, orientation, which camera is left."""
