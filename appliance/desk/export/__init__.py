"""Files for other programs: points, meshes and grids in common formats, each complete or not at all."""
