"""From a scene and its light to the 8-bit image of a camera."""
