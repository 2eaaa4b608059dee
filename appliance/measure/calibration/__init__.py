"""Content of a calibration: cameras, ports, corrections, covariances, and its patterns of ray gaps."""
