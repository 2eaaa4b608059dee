"""The projected patterns: the one list of frames that drives drawing, capturing and decoding."""
