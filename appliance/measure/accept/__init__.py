"""The measure of an instrument: artefacts found and fitted in clouds, after VDI/VDE 2634. Nothing here does I/O."""
