"""Objects with exactly known surfaces."""
