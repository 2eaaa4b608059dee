"""The people in the world: a diver with a script, a trainer at a console, a mouse user."""
