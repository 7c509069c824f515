"""The command ``palletloc calibrate intrinsics``: lenses from shots of boards."""
