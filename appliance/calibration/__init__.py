"""What was learned about one instrument: its calibration file, and how to make one."""
