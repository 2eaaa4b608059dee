"""From frames to points: phases, correspondence, refracted rays, quality."""
