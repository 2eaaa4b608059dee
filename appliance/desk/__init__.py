"""Work with stored scans away from the instrument: clouds, objects, comparison, reports, import, archives, Python."""
