"""The people who act on the world: a diver with a script, a trainer at a console, a mouse user."""
