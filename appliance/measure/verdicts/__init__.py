"""Owns the answer to whether a scan can be trusted: judgements of recorded sequences, each with its numbers."""
