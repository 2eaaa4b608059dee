"""The data that survives the loss of power: scans, their manifests, clouds, the status file."""
