"""Whether the camera still sits on the forklift as is stated."""
