"""Programs that run in an environment of their own: other people's decoders on our frames."""
