"""What changed as one: regions, what they are called, their figures, and whether what was measured bears them out."""
