"""Reprocessing of all scans of an archive: the task, its results, and the workers."""
