"""The page that is handed to a client: one HTML file with a surface that can be turned, its deviations, and how it came
about."""
