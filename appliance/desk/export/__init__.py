"""Files for other programs: points, meshes and grids in the formats that are read elsewhere, whole or not at all."""
