"""The verdict ``identity``: whether each frame shows its pattern."""
