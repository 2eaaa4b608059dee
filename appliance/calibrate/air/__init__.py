"""The calibration in air: lenses and the pose of both cameras, from boards."""
