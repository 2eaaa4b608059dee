"""The simulator's own optics: exact vector Snell through tilted, wedged slabs. Shares nothing with the product."""
