"""The value of one instrument's rig file for its keypad: the USB identity.

In the source tree it is that of the packaged rig file; ``kingfisher setup firmware keys`` writes it for any other.
"""

VENDOR = 0x1209
PRODUCT = 0x4B46
