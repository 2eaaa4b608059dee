"""Measurements of the product on this machine, and the demonstration: run by ``./dev bench`` and ``./dev demo``."""
