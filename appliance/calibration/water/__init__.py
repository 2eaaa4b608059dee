"""The calibration in water: from recordings of artefacts to ports, lenses and pose, by one of the ladder's methods."""
