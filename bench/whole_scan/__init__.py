"""Cost of a whole scan with all judges, from the last frame to the cloud on screen and disk."""
