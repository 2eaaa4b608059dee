"""The simulator's optics: exact vector Snell through tilted, wedged slabs; no code of the product."""
