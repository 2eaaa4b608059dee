"""The measuring core: images and a calibration become points, errors and verdicts. It knows no file, clock, device or screen."""
