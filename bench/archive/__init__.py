"""The archive measured and drawn: how small packed scans are, and the page of a season."""
