"""Everybody who acts on the world: a diver with a script, a trainer at a console, a hand on the mouse, and bad luck."""
