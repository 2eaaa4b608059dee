"""An independent physical world below the wires of the real devices, without code of the product."""
