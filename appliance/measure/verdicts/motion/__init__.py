"""The verdict on movement: drift of the fringes, moved edges and texture, and what they add to the noise of the points."""
