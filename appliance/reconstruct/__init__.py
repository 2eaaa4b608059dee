"""From frames to points: phases, correspondence, refracted rays, quality; and the process in which that happens."""
