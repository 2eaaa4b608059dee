"""The refractive camera model: light travels from a water point to a pixel and back through water, port and lens."""
