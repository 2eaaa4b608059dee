"""Reconstruction: frames become phases, correspondences, refracted rays, and points of known quality."""
