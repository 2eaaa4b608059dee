"""Owns the trigger board's firmware for MicroPython on RP2040 or RP2350; it imports nothing of the rest."""
