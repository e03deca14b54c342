"""One robot in rerun: its body and target, its dead-reckoned and its corrected path."""

from collections import deque

import numpy as np
import rerun as rr

from trigpoint.base.clock import to_ns
from trigpoint.contract.messages import Odometry, PoseArray, PoseEstimate, PoseStamped
from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array
from trigpoint.geometry.uncertainty import position_sigma
from trigpoint.site.target import Target

from . import style
from .camera import draw_ellipsoid
from .columns import Columns, Rate

_SEGMENT_NS = to_ns(0.5)
_STEP_M = 0.02
_CORRECTION_STEP_M = 0.3
_ABOVE_THE_LINE = np.array([0.0, 0.0, 0.03])
_NAME_AT = np.array([0.0, 0.0, -0.4])
"""Below the floor: cameras' names are above, so that the two do not cover each other."""
_MAP_PATIENCE_NS = to_ns(5.0)
_HELD_POSES = 20_000
_DRIFT_PERIOD_NS = to_ns(0.2)


class RobotScene:
    """Turns one robot's messages into rows.

    Odometry is placed in the map by the first map_from_odom that fusion sent, and stays there, so
    that its drift shows. The first robot's odometry frame is the map itself, as far as fusion does
    not say otherwise within some seconds.
    """

    def __init__(
        self, name: str, index: int, target: Target | None, columns: Columns, *, is_first: bool
    ) -> None:
        self.name, self._target, self._columns, self._is_first = name, target, columns, is_first
        self._colour = style.robot_colour(index)
        self._path = style.robot_path(name)
        self._map_from_odom: Pose | None = None
        self._held: deque[Odometry] = deque(maxlen=_HELD_POSES)
        self._recent: deque[tuple[int, Pose]] = deque(maxlen=256)
        self._reckoned = _Path(columns, f"{self._path}/dead_reckoning", style.DEAD_RECKONING)
        self._corrected = _Path(columns, f"{self._path}/corrected", self._colour)
        self._is_corrected = False
        self._drift_ns = 0
        self._rate = Rate(columns, f"{style.RATES}/{name}")
        self._last_correction: Array | None = None

    def announce(self) -> None:
        """Send what holds at every time: the target's faces, an arrow ahead, the plots' colours."""
        body = f"{self._path}/body"
        self._columns.fixed(
            f"{body}/ahead",
            rr.Arrows3D(vectors=[[0.6, 0, 0]], colors=[self._colour], radii=[style.ui_points(3.0)]),
        )
        self._columns.fixed(
            f"{body}/base",
            rr.Boxes3D(
                centers=[[0, 0, 0.08]],
                half_sizes=[[0.2, 0.16, 0.08]],
                colors=[self._colour],
                fill_mode="solid",
            ),
        )
        if self._target:
            self._columns.fixed(f"{body}/target", _target_mesh(self._target))
        for group in (style.ROBOT_SIGMAS, style.HEADING_SIGMAS, style.DRIFT, style.RATES):
            line = rr.SeriesLines(colors=[self._colour], names=[self.name], widths=[2.0])
            self._columns.fixed(f"{group}/{self.name}", line)

    def place_odometry(self, map_from_odom: Pose) -> None:
        """Take fusion's first word on where the odometry frame is; later ones are drift."""
        if self._map_from_odom is None:
            self._place(map_from_odom)

    def add_odometry(self, message: Odometry) -> None:
        self._rate.add(message.stamp_ns)
        if self._map_from_odom is not None:
            self._show_odometry(message, self._map_from_odom)
            return
        self._held.append(message)
        if self._is_first and message.stamp_ns - self._held[0].stamp_ns > _MAP_PATIENCE_NS:
            self._place(Pose.identity())

    def add_pose(self, message: PoseEstimate) -> None:
        """The corrected pose, at an odometry message's stamp."""
        self._is_corrected = True
        self._corrected.add(message.stamp_ns, message.pose.translation)
        self._move_body(message.stamp_ns, message.pose)
        self._show_drift(message)
        draw_ellipsoid(self._columns, f"{self._path}/uncertainty", message, self._colour)
        self._name_body(message.stamp_ns, message.pose)
        sigmas = f"{style.ROBOT_SIGMAS}/{self.name}"
        centimetres = style.decades(100 * position_sigma(message.covariance))
        self._columns.row(sigmas, message.stamp_ns, rr.Scalars, scalars=[centimetres])
        heading = style.decades(1000 * style.heading_sigma(message.covariance))
        headings = f"{style.HEADING_SIGMAS}/{self.name}"
        self._columns.row(headings, message.stamp_ns, rr.Scalars, scalars=[heading])

    def add_correction(self, message: PoseEstimate) -> None:
        """A dot where the robot was told that it is; standing still adds none."""
        position, last = message.pose.translation, self._last_correction
        if last is None or np.linalg.norm(position - last) > _CORRECTION_STEP_M:
            self._last_correction = position
            self._columns.row(
                f"{self._path}/corrections",
                message.stamp_ns,
                rr.Points3D,
                positions=[position + _ABOVE_THE_LINE],
                **style.dot(style.CORRECTION, 2.0),
            )

    def add_suggestion(self, message: PoseStamped) -> None:
        text = f"{self.name} next"
        where = message.pose.translation
        self._mark("suggestion", message.stamp_ns, where, self._colour, text)

    def add_particles(self, message: PoseArray) -> None:
        positions = list(message.poses.translation)
        self._columns.row(
            f"{self._path}/particles",
            message.stamp_ns,
            rr.Points3D,
            positions=positions,
            colors=[self._colour] * len(positions),
            radii=[style.ui_points(1.5)] * len(positions),
        )

    def finish(self) -> None:
        """Place what still waits for the map, and send the paths' ends."""
        if self._map_from_odom is None and self._is_first and self._held:
            self._place(Pose.identity())
        self._reckoned.finish()
        self._corrected.finish()

    @property
    def extent(self) -> list[Array]:
        """Corners of what was drawn, (3,) each."""
        return [*self._reckoned.extent, *self._corrected.extent]

    def _place(self, map_from_odom: Pose) -> None:
        self._map_from_odom = map_from_odom
        held, self._held = list(self._held), deque(maxlen=_HELD_POSES)
        for message in held:
            self._show_odometry(message, map_from_odom)

    def _show_odometry(self, message: Odometry, map_from_odom: Pose) -> None:
        map_from_base = map_from_odom @ message.pose
        self._recent.append((message.stamp_ns, map_from_base))
        if self._reckoned.add(message.stamp_ns, map_from_base.translation):
            # No text: it would lie over the robot's own; the legend says whose colour this is.
            where = map_from_base.translation
            dot = style.dot(style.DEAD_RECKONING, 5.0)
            entity = f"{self._path}/odometry_alone"
            self._columns.row(entity, message.stamp_ns, rr.Points3D, positions=[where], **dot)
        if not self._is_corrected:
            self._move_body(message.stamp_ns, map_from_base)
            self._name_body(message.stamp_ns, map_from_base)

    def _move_body(self, stamp_ns: int, map_from_base: Pose) -> None:
        self._columns.row(
            f"{self._path}/body",
            stamp_ns,
            rr.Transform3D,
            translation=[map_from_base.translation],
            quaternion=[map_from_base.quaternion],
        )

    def _show_drift(self, message: PoseEstimate) -> None:
        if message.stamp_ns - self._drift_ns < _DRIFT_PERIOD_NS:
            return
        for stamp_ns, map_from_base in self._recent:
            if stamp_ns == message.stamp_ns:
                self._drift_ns = stamp_ns
                away_m = np.linalg.norm(map_from_base.translation - message.pose.translation)
                entity = f"{style.DRIFT}/{self.name}"
                self._columns.row(entity, stamp_ns, rr.Scalars, scalars=[100 * float(away_m)])

    def _mark(
        self, name: str, stamp_ns: int, position: Array, colour: style.Colour, text: str
    ) -> None:
        """A dot with a text beside it."""
        entity = f"{self._path}/{name}"
        dot = style.dot(colour, 5.0)
        self._columns.row(entity, stamp_ns, rr.Points3D, positions=[position], **dot)
        words = style.text_only(text)
        self._columns.row(f"{entity}/text", stamp_ns, rr.Points3D, positions=[position], **words)

    def _name_body(self, stamp_ns: int, map_from_base: Pose) -> None:
        """The name alone: a longer label covers those of the cameras that it passes."""
        self._columns.row(
            f"{self._path}/name",
            stamp_ns,
            rr.Points3D,
            positions=[map_from_base.translation + _NAME_AT],
            **style.text_only(self.name),
        )


class _Path:
    """A growing line, sent as pieces of half a second; the blueprint shows all pieces up to now."""

    def __init__(self, columns: Columns, entity: str, colour: style.Colour) -> None:
        self._columns, self._entity, self._colour = columns, entity, colour
        self._points: list[Array] = []
        self._started_ns = self._last_ns = 0
        self._low = np.full(3, np.inf)
        self._high = np.full(3, -np.inf)

    def add(self, stamp_ns: int, position: Array) -> bool:
        """Append a point where it is far enough from the last one; return whether it was."""
        if self._points and float(np.linalg.norm(position - self._points[-1])) < _STEP_M:
            return False
        if not self._points:
            self._started_ns = stamp_ns
        self._points.append(position)
        self._last_ns = stamp_ns
        self._low, self._high = np.minimum(self._low, position), np.maximum(self._high, position)
        if stamp_ns - self._started_ns >= _SEGMENT_NS:
            self.finish()
        return True

    def finish(self) -> None:
        """Send the piece; the next one starts at its end."""
        if len(self._points) < 2:
            return
        self._columns.row(
            self._entity,
            self._last_ns,
            rr.LineStrips3D,
            strips=[np.array(self._points)],
            colors=[self._colour],
            radii=[style.ui_points(1.8)],
        )
        self._points, self._started_ns = self._points[-1:], self._last_ns

    @property
    def extent(self) -> list[Array]:
        """The box around the path, as two corners; nothing where there is no path."""
        return [self._low, self._high] if np.all(np.isfinite(self._low)) else []


def _target_mesh(target: Target) -> rr.Mesh3D:
    """The target's faces in the base frame, each in the colour of its sightings."""
    corners = [face.base_from_face @ face.outline for face in target.faces]
    quad = np.array([[0, 1, 2], [0, 2, 3]])
    triangles = np.concatenate([4 * i + quad for i in range(len(corners))])
    colours = [style.face_colour(face.id) for face in target.faces for _ in range(4)]
    return rr.Mesh3D(
        vertex_positions=np.concatenate(corners),
        triangle_indices=triangles,
        vertex_colors=colours,
    )
