"""Registration of many scans into one object: scan poses with their uncertainties, or reasons why there are none."""
