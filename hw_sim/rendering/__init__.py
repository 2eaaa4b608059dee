"""Rendering: a scene and its light become the 8-bit image of a camera."""
