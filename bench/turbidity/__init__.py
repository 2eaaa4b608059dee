"""How accuracy, noise and completeness depend on the water, in simulation."""
