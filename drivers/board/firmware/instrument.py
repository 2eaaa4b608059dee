"""Owns what one instrument's rig file says to its board: the USB identity, and which way the projector's sync goes.

In the source tree it is what the packaged rig file says; ``kingfisher setup firmware board`` writes it for any other.
"""

VENDOR = 0x1209
PRODUCT = 0x4B42
SYNC_RISES = False
"""The sync at the pin begins with a rising edge; ``False``: with a falling one, as at 1024x768 and 60 Hz."""
