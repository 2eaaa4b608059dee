"""The keypad's firmware for MicroPython on RP2040; it imports no other part of the product."""
