"""The archive measured: how small packed scans are, and how many scans are worked through how fast by whom."""
