"""Accuracy of ranging by laser dots: scenes, truth, study, picture."""
