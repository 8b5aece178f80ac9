"""Maps mended: scan graphs with few, no and false loops, a raw log, and ray-cast worlds with clouds on disk."""
