"""All that is between instrument and object: water that dims and scatters, and what drifts, rises and swims in it."""
