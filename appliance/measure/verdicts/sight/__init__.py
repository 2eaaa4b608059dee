"""The verdict on what is seen at all: fringes, light, and how far away their object lies."""
