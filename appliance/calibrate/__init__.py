"""Making a calibration, in air and in water, and telling whether it still holds."""
