"""Files at the border: recordings in, measurements out; everything is checked here once."""
