"""Holds the words that every other package speaks: sides, faults, verdicts, exposures, camera noise. No I/O, no kernels."""
