"""Where the camera and the shelf are: the mounting on the forklift and the shelf's front plane.

The scope of this package is printed targets and their observations, the camera's pose on the forklift with
its uncertainty, the shelf plane from measured pallets, and the comparison with a total station's survey.
It imports nothing but `palletloc`. This version has targets, the camera's mounting, and its lenses with the camera
files of other programs; the shelf plane comes from the user.
"""
