"""The package draws what the diver sees: views go in as values, pictures come out."""
