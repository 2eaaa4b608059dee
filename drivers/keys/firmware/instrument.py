"""Owns what one instrument's rig file says to its key pad: the USB identity.

In the source tree it is what the packaged rig file says; ``kingfisher setup firmware keys`` writes it for any other.
"""

VENDOR = 0x1209
PRODUCT = 0x4B46
