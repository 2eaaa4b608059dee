"""Owns how scans are given to a desk that has a key, and only while the diver's menu says so; standard library only."""
