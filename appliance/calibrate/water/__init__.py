"""The calibration in water: from recordings of artefacts to ports, lenses and pose, by one of three methods."""
