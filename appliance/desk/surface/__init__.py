"""Surfaces from organised clouds: normals, meshes, fusion of many placed scans, and deviations from a nominal surface."""
