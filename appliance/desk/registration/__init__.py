"""Registration of many scans into one object: scan poses with uncertainties, or reasons for none."""
