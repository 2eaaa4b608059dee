"""Owns the one error of the setup: what went wrong, and what to do."""


class SetupError(Exception):
    """One line that names the thing and the remedy. Nothing half-made is in use when it is raised."""
