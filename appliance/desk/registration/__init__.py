"""Scans placed relative to each other, each placement with its uncertainty or a reason why there is none."""
