"""Scene: places of the held bodies, and their contacts."""
