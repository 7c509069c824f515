"""Points that a total station has surveyed: reading and writing its files."""
