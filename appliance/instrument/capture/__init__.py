"""Capture of one scan: arm, play, collect, and compare the witnesses."""
