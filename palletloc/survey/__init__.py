"""The total station: surveyed points from its files, and the pallets' true poses from these points."""
