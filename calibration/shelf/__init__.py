"""Where the shelf's front is, from a drive past it."""
