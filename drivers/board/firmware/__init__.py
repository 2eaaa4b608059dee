"""The trigger board's firmware for MicroPython on RP2040 or RP2350.

It imports no other part of the product.
"""
