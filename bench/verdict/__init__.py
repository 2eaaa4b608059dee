"""What the verdict is worth: each part draws scans at random, lets the product judge them, and knows the truth."""
