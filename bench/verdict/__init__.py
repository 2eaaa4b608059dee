"""Accuracy of the verdicts: each part draws random scans, lets the product judge them, and knows the truth."""
