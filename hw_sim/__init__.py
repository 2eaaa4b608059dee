"""An independent physical world under the same wires as the real devices; it shares no code with the product."""
