"""Acceptance of an instrument: artefacts in clouds, found and fitted after VDI/VDE 2634. No I/O."""
