"""Surfaces from clouds on the pixel grid: normals, meshes, one surface of many placed scans, and how far points lie
from a nominal one."""
