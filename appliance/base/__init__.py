"""Ground of all rooms: compiled kernels and their place, how a process starts, sealed files, libraries that may be missing."""
