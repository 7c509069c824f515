"""The yaml files of a recording as people write them: units in the names, angles in degrees."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import BeforeValidator, Field, model_validator
from pydantic_core import PydanticCustomError

from palletloc.io.images import MAX_SIDE_PX
from palletloc.io.yaml_document import Document, Numbers

Number = Annotated[float, BeforeValidator(Numbers())]
"""One finite number."""
Angle = Annotated[float, BeforeValidator(Numbers(positive=True)), Field(le=180.0)]
"""How far off its axis a lens sees, in degrees."""
_Pair = Annotated[tuple[float, float], BeforeValidator(Numbers(2))]
"""Two finite numbers."""
Focal = Annotated[tuple[float, float], BeforeValidator(Numbers(2, positive=True))]
"""Two positive numbers."""
Triple = Annotated[tuple[float, float, float], BeforeValidator(Numbers(3))]
"""Three finite numbers."""
_Sigmas = Annotated[tuple[float, float, float], BeforeValidator(Numbers(3, non_negative=True))]
"""Three standard deviations."""
_FourNumbers = Annotated[tuple[float, float, float, float], BeforeValidator(Numbers(4))]
"""Four finite numbers."""
_FiveNumbers = Annotated[tuple[float, float, float, float, float], BeforeValidator(Numbers(5))]
"""Five finite numbers."""
_PART_OF_PANORAMA = (
    "an equirectangular image is 360 x 180 degrees, twice as wide as high, but the camera is {width} x {height} px;"
    " expected images of all of it: a cropped one has to be padded, here to {whole} px if it goes all around"
)
"""What is said of a camera whose images cannot be whole panoramas."""
_EightNumbers = Annotated[tuple[float, float, float, float, float, float, float, float], BeforeValidator(Numbers(8))]
"""Eight finite numbers."""
Pixels = Annotated[int, Field(strict=True, gt=0, le=MAX_SIDE_PX)]
"""Width or height of an image."""


class _CameraKeys(Document):
    """What every camera begins with."""

    model: str
    width: Pixels
    height: Pixels


class _LensKeys(Document):
    """What every lens begins with."""

    focal_px: Focal
    center_px: _Pair
    """In the whole image, as the camera writes it."""


class _PanoramaKeys(_CameraKeys):
    """A whole panorama, which is twice as wide as high: 360 degrees around, 180 from top to bottom."""

    @model_validator(mode="after")
    def _show_all(self) -> Self:
        if abs(self.width - 2 * self.height) > 2:  # encoders round sizes to even numbers
            shown = {"width": self.width, "height": self.height, "whole": f"{self.width} x {self.width // 2}"}
            raise PydanticCustomError("panorama", _PART_OF_PANORAMA, shown)
        return self


class EquirectangularSpec(_PanoramaKeys):
    """A stitched 360-degree image."""

    model: Literal["equirectangular"]


class PinholeSpec(_LensKeys, _CameraKeys):
    """A pinhole camera with Brown's distortion."""

    model: Literal["pinhole"]
    distortion: _FiveNumbers
    """k1, k2, p1, p2, k3, as OpenCV orders them."""


class RationalPinholeSpec(_LensKeys, _CameraKeys):
    """A pinhole camera with the rational distortion of OpenCV."""

    model: Literal["rational_pinhole"]
    distortion: _EightNumbers
    """k1, k2, p1, p2, k3, k4, k5, k6, as OpenCV orders them."""


class KannalaBrandtSpec(_LensKeys, _CameraKeys):
    """A fisheye lens in the model of Kannala and Brandt."""

    model: Literal["kannala_brandt"]
    distortion: _FourNumbers
    """k1, k2, k3, k4."""
    max_angle_deg: Angle


class MeiSpec(_LensKeys, _CameraKeys):
    """A wide camera in the unified model of Mei, with Brown's distortion."""

    model: Literal["mei"]
    xi: Number
    distortion: _FourNumbers
    """k1, k2, p1, p2."""
    max_angle_deg: Angle


class DoubleSphereSpec(_LensKeys, _CameraKeys):
    """A fisheye lens in the double sphere model."""

    model: Literal["double_sphere"]
    xi: Number
    alpha: Number
    max_angle_deg: Angle


class EucmSpec(_LensKeys, _CameraKeys):
    """A fisheye lens in the enhanced unified camera model."""

    model: Literal["eucm"]
    alpha: Number
    beta: Number
    max_angle_deg: Angle


class LensSpec(_LensKeys):
    """One lens of a dual fisheye camera, in the model of Kannala and Brandt."""

    distortion: _FourNumbers
    max_angle_deg: Angle
    translation_m: Triple
    """The lens's optical centre in the camera frame."""
    roll_pitch_yaw_deg: Triple
    """Its orientation there: R = Rz(yaw) Ry(pitch) Rx(roll)."""


class DualFisheyeSpec(_CameraKeys):
    """Two fisheye lenses back to back, before stitching."""

    model: Literal["dual_fisheye"]
    lenses: Annotated[tuple[LensSpec, ...], Field(min_length=2, max_length=2)]


class StitchedLensSpec(Document):
    """One lens behind a stitched image."""

    translation_m: Triple
    """Its optical centre in the camera frame."""
    roll_pitch_yaw_deg: Triple
    """Its orientation there: R = Rz(yaw) Ry(pitch) Rx(roll); nominally no turn for the front lens, 180 of yaw for
    the back one."""
    bend: _Pair
    """k1, k2: what was at theta off its axis was stitched at theta (1 + k1 theta^2 + k2 theta^4)."""


class StitchedSpec(_PanoramaKeys):
    """A stitched 360-degree image with the lenses behind it."""

    model: Literal["stitched_equirectangular"]
    lenses: Annotated[tuple[StitchedLensSpec, ...], Field(min_length=2, max_length=2)]


CameraSpec = Annotated[
    EquirectangularSpec
    | KannalaBrandtSpec
    | MeiSpec
    | DoubleSphereSpec
    | EucmSpec
    | PinholeSpec
    | RationalPinholeSpec
    | DualFisheyeSpec
    | StitchedSpec,
    Field(discriminator="model"),
]
"""Any camera model, distinguished by its key ``model``."""


class MountingSpec(Document):
    """Where the camera is on the forklift."""

    translation_m: Triple
    roll_pitch_yaw_deg: Triple
    """R = Rz(yaw) Ry(pitch) Rx(roll)."""
    translation_sigma_m: _Sigmas | None = None
    """Standard deviations along the forklift's axes."""
    rotation_sigma_deg: _Sigmas | None = None
    """Standard deviations about the forklift's axes."""


class ShelfSpec(Document):
    """The nominal front plane of the shelf, in odom."""

    point_m: _Pair
    facing_deg: Number
    """Heading of the normal that points from the shelf into the aisle."""
    levels_m: tuple[Number, ...] | None = None
    """Heights that loads stand on."""


class PathSpec(Document):
    """What a file of poses cannot say itself."""

    frame: Literal["body", "optical"] | None = None
    """Whose poses they are: of a body with z up, or of a camera with z forward."""
    rotation_deg: Triple | None = None
    """Roll, pitch and yaw of that body in the forklift frame."""
    times: str | None = None
    """File with the times of poses in KITTI form, one a line, in seconds."""


class OdometrySpec(PathSpec):
    """Where the odometry is, and what it cannot say itself."""

    file: str = "odometry.csv"


class RecordingSpec(Document):
    """The file recording.yaml."""

    format: Literal[1]
    camera: CameraSpec
    forklift_from_camera: MountingSpec
    shelf: ShelfSpec
    pallets: Annotated[tuple[str, ...], Field(min_length=1)]
    """Names of pallet models."""
    odometry: OdometrySpec | None = None
    """Where it is not in odometry.csv, or not of the forklift's own frame."""
    truth: PathSpec | None = None
    """Of the file of the forklift's path, truth/forklift.csv or forklift.tum."""
