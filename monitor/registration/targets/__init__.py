"""Survey targets: spheres and boards in a scan, and which points of two sets are the same."""
