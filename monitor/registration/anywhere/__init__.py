"""From anywhere, by shape alone: scans and epochs of which nobody knows where they stood, or which way round."""
