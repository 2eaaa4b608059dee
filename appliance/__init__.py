"""Kingfisher: the product. Patterns, optics, capture, reconstruction, calibration, screens, storage, service."""

__version__ = "0.1.0"
