"""What the diver sees: views go in as values, pictures come out."""
