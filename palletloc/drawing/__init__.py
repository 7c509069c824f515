"""Pictures for people: what the program knows and what it saw."""
