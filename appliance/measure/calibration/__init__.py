"""Content of a calibration: cameras, ports, corrections, covariances, and what ray gaps tell about it."""
