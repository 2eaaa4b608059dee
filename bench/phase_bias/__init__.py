"""Systematic phase errors of image-level scans, and their effect on points and artefacts."""
