"""Surfaces from organised clouds: normals, meshes, fusion, and deviations from a nominal surface."""
