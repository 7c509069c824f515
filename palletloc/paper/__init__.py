"""The steps and methods of the paper, kept beside the default method to compare with it."""
