"""The judges of a scan: each returns a verdict with its numbers."""
