"""The camera on the forklift, from surveyed targets."""
