"""Accuracy and verdicts of the instrument in the simulated world ``outside``, part by part."""
