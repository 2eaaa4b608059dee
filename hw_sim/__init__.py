"""An independent physical world under the same wires as the real devices; shares nothing with the product."""
