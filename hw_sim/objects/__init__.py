"""Things that are looked at, with exactly known surfaces."""
