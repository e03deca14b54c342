"""One camera in rerun: its frustum, uncertainty, picture, and what was sighted in it."""

from collections import deque
from collections.abc import Sequence

import numpy as np
import rerun as rr

from trigpoint.base.clock import to_ns
from trigpoint.base.words import plus_minus
from trigpoint.contract.messages import CameraInfo, FaceSighting, Picture, PoseEstimate, Sightings
from trigpoint.geometry import CameraModel
from trigpoint.geometry.rotation import Array, to_quaternion
from trigpoint.geometry.uncertainty import position_sigma

from . import style
from .columns import Columns, Rate
from .hull import outline
from .log import LogLine
from .pixel_residuals import Residual
from .verdicts import VerdictScene

FRUSTUM_DEPTH_M = 0.8
_FRUSTUM_PERIOD_NS = to_ns(1.0)
_NAME_ABOVE = np.array([0.0, 0.0, 0.3])
_SEEN_STEP_PX = 12.0
_SHOWN_NS = to_ns(1.0)
_PICTURES_ARE_LIVE_NS = to_ns(3.0)
_LATENCY_PERIOD_NS = to_ns(0.5)
_PLOTS = (
    style.CAMERA_SIGMAS,
    style.HEADING_SIGMAS,
    style.LATENCY,
    style.RATES,
)
_LATEST_NS = to_ns(10.0)  # more is a replay, whose stamps are of another time


class CameraScene:
    """Turns one camera's messages into rows. A camera stands in the map once it is located."""

    def __init__(
        self,
        name: str,
        index: int,
        camera: CameraModel,
        columns: Columns,
        log: LogLine,
        *,
        is_crowded: bool = False,
    ) -> None:
        """`is_crowded`: there are so many cameras that labels in the map are names alone."""
        self.name, self._camera, self._columns, self._log = name, camera, columns, log
        self._is_crowded = is_crowded
        self._rate = Rate(columns, f"{style.RATES}/{name}")
        self._verdicts = VerdictScene(name, columns, log)
        self.estimate: PoseEstimate | None = None
        self._colour = style.camera_colour(index)
        self._path, self._frustum = style.camera_path(name), style.frustum_path(name)
        self._picture = style.picture_path(name)
        self._frustum_ns = self._latency_ns = 0
        self._is_located = False
        self._recent: deque[Sightings] = deque(maxlen=64)
        self._seen: deque[Array] = deque(maxlen=512)
        self._picture_ns: int | None = None
        self._drawn_ns: int | None = None
        self.position: Array | None = None

    def announce(self) -> None:
        """Send what holds at every time."""
        width, height = self._camera.width, self._camera.height
        frame = [[0, 0], [width, 0], [width, height], [0, height], [0, 0]]
        border = rr.LineStrips2D([frame], colors=[self._colour], radii=[style.ui_points(1.0)])
        self._columns.fixed(f"{self._picture}/border", border)
        line = rr.SeriesLines(colors=[self._colour], names=[self.name], widths=[2.0])
        for group in _PLOTS:
            self._columns.fixed(f"{group}/{self.name}", line)
        # A camera sees a robot now and then: a line would join what lies minutes apart.
        points = rr.SeriesPoints(colors=[self._colour], names=[self.name], marker_sizes=[2.5])
        self._columns.fixed(f"{style.RESIDUALS}/{self.name}", points)

    def add_info(self, message: CameraInfo) -> None:
        self._camera = message.camera
        if self._is_located:
            self._show_pinhole(message.stamp_ns)

    def add_pose(self, message: PoseEstimate) -> None:
        stamp_ns, pose = message.stamp_ns, message.pose
        sigma_m = position_sigma(message.covariance)
        self.position, self.estimate = pose.translation, message
        if not self._is_located:
            self._is_located = True
            self._show_pinhole(stamp_ns)
            self._log(stamp_ns, "INFO", f"{self.name} located, {plus_minus(sigma_m)}")
        self._columns.row(
            self._path,
            stamp_ns,
            rr.Transform3D,
            translation=[pose.translation],
            quaternion=[pose.quaternion],
        )
        draw_ellipsoid(self._columns, f"/map/uncertainty/{self.name}", message, self._colour)
        said = f"{self.name} {plus_minus(sigma_m)}"
        self._columns.row(
            f"/map/names/{self.name}",
            stamp_ns,
            rr.Points3D,
            positions=[pose.translation + _NAME_ABOVE],
            **style.text_only(self.name if self._is_crowded else said),
        )
        sigmas = f"{style.CAMERA_SIGMAS}/{self.name}"
        centimetres = style.decades(100 * sigma_m)
        self._columns.row(sigmas, stamp_ns, rr.Scalars, scalars=[centimetres])
        heading = style.decades(1000 * style.heading_sigma(message.covariance))
        headings = f"{style.HEADING_SIGMAS}/{self.name}"
        self._columns.row(headings, stamp_ns, rr.Scalars, scalars=[heading])

    def add_picture(self, message: Picture) -> None:
        """Show a picture with the sightings that were made in it, which come before or after."""
        self._columns.picture(self._picture, message.stamp_ns, message.data)
        self._picture_ns = message.stamp_ns
        if self._is_located and message.stamp_ns - self._frustum_ns >= _FRUSTUM_PERIOD_NS:
            self._columns.picture(self._frustum, message.stamp_ns, message.data)
            self._frustum_ns = message.stamp_ns
        same = [s for s in self._recent if s.stamp_ns == message.stamp_ns]
        self._draw(message.stamp_ns, same[-1].faces if same else ())

    def add_sightings(self, message: Sightings) -> None:
        """Draw on the picture of the same stamp; on nothing where pictures are not sent."""
        self._recent.append(message)
        self._rate.add(message.stamp_ns)
        for face in message.faces:
            self._remember(message.stamp_ns, np.mean(face.pixels, axis=0))
        picture_ns = self._picture_ns
        if picture_ns == message.stamp_ns:
            self._draw(message.stamp_ns, message.faces)
        elif picture_ns is None or message.stamp_ns - picture_ns > _PICTURES_ARE_LIVE_NS:
            self._wipe_before(message.stamp_ns)
            self._draw(message.stamp_ns, message.faces)

    @property
    def lens(self) -> CameraModel:
        return self._camera

    def add_residuals(self, message: Sightings, residuals: Sequence[Residual | None]) -> None:
        """Draw what each face of a picture is off, by where it should be seen."""
        self._verdicts.add(message.stamp_ns, residuals)
        if self._drawn_ns == message.stamp_ns:
            self._verdicts.draw(message.stamp_ns)

    def add_latency(self, stamp_ns: int, received_ns: int) -> None:
        """How much later than the exposure a sighting came."""
        after_ns = received_ns - stamp_ns
        if 0 <= after_ns < _LATEST_NS and stamp_ns - self._latency_ns >= _LATENCY_PERIOD_NS:
            self._latency_ns = stamp_ns
            entity = f"{style.LATENCY}/{self.name}"
            self._columns.row(entity, stamp_ns, rr.Scalars, scalars=[after_ns / 1e6])

    def finish(self, stamp_ns: int) -> None:
        """Take old sightings away at the end."""
        self._wipe_before(stamp_ns)

    def _remember(self, stamp_ns: int, middle: Array) -> None:
        """A dot that stays: where in its picture a camera has seen the target so far."""
        if not self._seen or min(np.linalg.norm(middle - s) for s in self._seen) > _SEEN_STEP_PX:
            self._seen.append(middle)
            self._columns.row(
                style.seen_path(self.name),
                stamp_ns,
                rr.Points2D,
                positions=[middle],
                **style.dot(self._colour, 2.0),
            )

    def _wipe_before(self, stamp_ns: int) -> None:
        """Where a camera only speaks when it sees something, a sighting is shown for a second."""
        if self._drawn_ns is not None and stamp_ns - self._drawn_ns > _SHOWN_NS:
            self._draw(self._drawn_ns + _SHOWN_NS, ())

    def _draw(self, stamp_ns: int, faces: tuple[FaceSighting, ...]) -> None:
        colours = [style.face_colour(face.face) for face in faces]
        pixels = [np.asarray(face.pixels, dtype=float) for face in faces]
        self._columns.row(
            f"{self._picture}/corners",
            stamp_ns,
            rr.Points2D,
            positions=[point for points in pixels for point in points],
            colors=[c for c, points in zip(colours, pixels, strict=True) for _ in points],
            radii=[style.ui_points(2.0)] * sum(len(points) for points in pixels),
        )
        self._columns.row(
            f"{self._picture}/faces",
            stamp_ns,
            rr.LineStrips2D,
            strips=[outline(points) for points in pixels],
            colors=colours,
            radii=[style.ui_points(1.5)] * len(faces),
        )
        self._columns.row(
            f"{self._picture}/names",
            stamp_ns,
            rr.Points2D,
            positions=[points[np.argmax(points[:, 1])] for points in pixels],
            colors=[style.TEXT] * len(faces),
            radii=[style.ui_points(0.0)] * len(faces),
            labels=[_label(face) for face in faces],
        )
        self._drawn_ns = stamp_ns if faces else None
        self._verdicts.draw(stamp_ns)

    def _show_pinhole(self, stamp_ns: int) -> None:
        camera = self._camera
        self._columns.row(
            self._frustum,
            stamp_ns,
            rr.Pinhole,
            image_from_camera=[camera.matrix],
            resolution=[[camera.width, camera.height]],
            camera_xyz=[rr.components.ViewCoordinates.RDF],
            image_plane_distance=[FRUSTUM_DEPTH_M],
            color=[self._colour],
            line_width=[style.ui_points(2.0)],
        )


def draw_ellipsoid(
    columns: Columns, entity: str, estimate: PoseEstimate, colour: style.Colour
) -> None:
    """A pose's position uncertainty, as large as the map's title says."""
    half_sizes, axes = style.ellipsoid(estimate.covariance[:3, :3])
    columns.row(
        entity,
        estimate.stamp_ns,
        rr.Ellipsoids3D,
        centers=[estimate.pose.translation],
        half_sizes=[half_sizes],
        quaternions=[to_quaternion(axes)],
        colors=[colour],
        fill_mode=[rr.components.FillMode.TransparentFillMajorWireframe],
        line_radii=[style.ui_points(1.5)],
    )


def _label(face: FaceSighting) -> str:
    """The number alone: faces are beside each other, and longer words would cover one another's."""
    return str(face.face) if face.face >= 0 else "?"
