"""Rendering turns a scene and its light into the 8-bit image of a camera."""
