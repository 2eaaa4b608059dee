"""How well a hidden rig measures after each rung of the calibration ladder, from images to numbers."""
