"""Owns the key pad's firmware for MicroPython on RP2040; it imports nothing of the rest."""
