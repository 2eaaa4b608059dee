"""Owns what is done with a new instrument at the bench, before it runs: its boards' firmware, and the guided bring-up, one file a step."""
