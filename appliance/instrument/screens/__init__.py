"""The diver's screens: view models go in as values, pictures come out."""
