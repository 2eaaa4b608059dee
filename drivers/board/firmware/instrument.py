"""The values of one instrument's rig file for its board: USB identity and polarity of the sync.

In the source tree they are those of the packaged rig file; ``kingfisher setup firmware board`` writes them for any
other.
"""

VENDOR = 0x1209
PRODUCT = 0x4B42
SYNC_RISES = False
"""True if the sync at the pin begins with a rising edge; ``False``: with a falling one, as at 1024x768 and 60 Hz."""
