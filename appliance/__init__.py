"""Kingfisher: the product. Patterns, optics, capture, reconstruction, calibration, screens, storage, service."""

__version__ = "1.0.0rc1"
