"""Light from the projector to the pixel: patterns, exposure, noise, lenses, ports and water."""
