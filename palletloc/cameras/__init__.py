"""Camera models, all in the frame x forward, y left, z up, behind one protocol."""

from palletloc.cameras.double_sphere import DoubleSphere
from palletloc.cameras.dual_fisheye import DualFisheye, FisheyeLens
from palletloc.cameras.equirectangular import Equirectangular
from palletloc.cameras.eucm import Eucm
from palletloc.cameras.kannala_brandt import KannalaBrandt
from palletloc.cameras.mei import Mei
from palletloc.cameras.pinhole import Pinhole, RationalPinhole
from palletloc.cameras.protocol import CameraModel, Projection, Rays
from palletloc.cameras.stitched_equirectangular import StitchedEquirectangular, StitchedLens

__all__ = [
    "CameraModel",
    "DoubleSphere",
    "DualFisheye",
    "Equirectangular",
    "Eucm",
    "FisheyeLens",
    "KannalaBrandt",
    "Mei",
    "Pinhole",
    "Projection",
    "RationalPinhole",
    "Rays",
    "StitchedEquirectangular",
    "StitchedLens",
]
