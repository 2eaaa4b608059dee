"""Calibrations made and described away from the instrument: from folders of pictures and from stored scans."""
