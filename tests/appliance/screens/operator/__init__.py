"""The operator's papers, made from the instrument's own tables: dive card, key map, alarm list."""
