"""The verdict ``motion``: drift of the fringes, moved edges and texture, and the noise that motion adds to the points."""
