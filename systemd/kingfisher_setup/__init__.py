"""Puts Kingfisher on an instrument, takes a new version on trial, and goes back. Standard library only."""
