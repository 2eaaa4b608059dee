"""Work on stored scans and pictures without the running instrument; it knows neither a device nor the heartbeat."""
