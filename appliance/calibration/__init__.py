"""The knowledge about one instrument: its calibration file, and how one is made."""
