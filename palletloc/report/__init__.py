"""Pages for people: what a run gave, and how far it was from the truth."""
