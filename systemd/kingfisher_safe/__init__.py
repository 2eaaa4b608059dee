"""The screen that is left when the service cannot start: what is wrong, what to do. Standard library only."""
