"""The verdict ``motion``: drift of the fringes, moved edges and texture, and the added noise."""
