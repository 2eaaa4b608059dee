"""What the distance from the laser dots is worth: scenes, truth, study, picture."""
