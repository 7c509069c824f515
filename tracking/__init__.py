"""Pallets over time: measurements of single shots fused with the forklift's odometry.

The scope of this package is the odometry between shots, the filter and the life of a track, the stream
of live use and the smoother for recordings. It imports nothing but `palletloc`.
This version has none of it yet: every shot is measured on its own.
"""
