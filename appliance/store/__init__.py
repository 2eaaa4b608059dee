"""Everything that is kept: formats and their promises, the library of scans, the rig file, and a stored scan processed again."""
