"""What of a site is shown where, so that all of it is seen without a click."""

import math

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from rerun.blueprint.encodings import TextLogColumn, TextLogColumnKind, TimelineColumn
from rerun.encodings import TimeRange

from trigpoint.geometry.rotation import Array
from trigpoint.site.config import Site

from . import style
from .columns import TIMELINE

_SO_FAR = rrb.VisibleTimeRanges(
    timeline=TIMELINE,
    start=rr.TimeRangeBoundary.infinite(),
    end=rr.TimeRangeBoundary.cursor_relative(seconds=0),
)


def blueprint(
    site: Site, extent: tuple[Array, Array] | None, span_ns: tuple[int, int] | None = None
) -> rrb.Blueprint:
    """The map large on the left, pictures on the right, plots, log and legend below.

    `extent`: two corners of what stands in the map, for the eye's place; None: rerun chooses.
    `span_ns`: the first and the last stamp of a session that is over, all of which the plots show.
    The time follows what comes; where nothing comes any more, it stands at the end («paused» would
    be at the beginning, and no blueprint can say a time).
    """
    axis = _axis(*span_ns) if span_ns else None
    pictures = [_picture_view(camera) for camera in site.cameras]
    return rrb.Blueprint(
        rrb.Vertical(
            rrb.Horizontal(
                _map_view(site, extent),
                rrb.Grid(*pictures, grid_columns=_grid_columns(len(pictures))),
                column_shares=[3, 2],
            ),
            rrb.Horizontal(
                _plot("Cameras: 10^y cm (-1: below 0.1)", style.CAMERA_SIGMAS, axis),
                _plot("Robots: 10^y cm", style.ROBOT_SIGMAS, axis),
                _plot("Headings: 10^y mrad", style.HEADING_SIGMAS, axis),
                rrb.Tabs(
                    _plot("Residuals, px", style.RESIDUALS, axis),
                    _plot("Odometry off, cm", style.DRIFT, axis),
                    _plot("Latency, ms", style.LATENCY, axis),
                    _plot("Rates, Hz", style.RATES, axis),
                ),
                rrb.Tabs(
                    rrb.TextLogView(origin=style.LOG, name="Log", columns=_LOG_COLUMNS),
                    rrb.TextDocumentView(origin=style.LEGEND, name="Legend"),
                ),
                column_shares=[3, 2.4, 2.7, 3.4, 5],
            ),
            row_shares=[5, 2],
        ),
        rrb.TimePanel(state="collapsed", timeline=TIMELINE, play_state="following"),
        collapse_panels=True,
    )


def _map_view(site: Site, extent: tuple[Array, Array] | None) -> rrb.Spatial3DView:
    lines = [f"{style.robot_path(r)}/{part}" for r in site.robots for part in _PATHS]
    dots = [f"{style.robot_path(r)}/corrections" for r in site.robots]
    return rrb.Spatial3DView(
        origin="/map",
        name=f"Map (ellipsoids: {style.SIGMAS_DRAWN:.0f} sigma, {style.MAGNIFIED:.0f} × larger)",
        overrides={entity: [_SO_FAR] for entity in (*lines, *dots)},
        line_grid=rrb.LineGrid3D(spacing=1.0, color=[160, 170, 190, 60]),
        background=list(style.FLOOR),
        eye_controls=_eye(*extent) if extent else None,
    )


_LOG_COLUMNS = rrb.TextLogColumns(
    timeline_columns=[TimelineColumn(TIMELINE, visible=False)],
    text_log_columns=[
        TextLogColumn(TextLogColumnKind.LogLevel),
        TextLogColumn(TextLogColumnKind.Body),
    ],
)
_PATHS = ("dead_reckoning", "corrected")


def _eye(low: Array, high: Array) -> rrb.EyeControls3D:
    """From above and the side that shows the box broad, as near as all of it is in the view."""
    middle = (low + high) / 2
    half = np.maximum((high - low) / 2, 0.5) + _MARGIN_M
    corners = half * np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    is_broad = half[0] >= half[1]
    right = np.array([1.0, 0, 0]) if is_broad else np.array([0, 1.0, 0])
    back = _STEEPNESS * np.array([0, 0, 1.0]) + 0.6 * np.cross(right, [0, 0, 1.0])
    up = np.cross(back, right)
    # A corner at (r, u, b) of the eye's axes is in the view where r and u are below the tangents of
    # half the view's angles times its depth, which is the eye's distance minus b.
    sideways = np.abs(corners @ right) / _TANGENT_ACROSS
    upwards = np.abs(corners @ up) / _TANGENT_UP
    distance = float(np.max(np.maximum(sideways, upwards) + corners @ back))
    position = middle + distance * back
    return rrb.EyeControls3D(position=position, look_target=middle, eye_up=[0.0, 0.0, 1.0])


_MARGIN_M = 0.4
_STEEPNESS = 0.8
_TANGENT_UP, _TANGENT_ACROSS = 0.5, 0.7
"""Of half the view's angles: rerun's eye has 55° upright; a little is left free at the edges."""


def _picture_view(camera: str) -> rrb.Spatial2DView:
    origin = style.picture_path(camera)
    return rrb.Spatial2DView(
        origin=origin, name=camera, overrides={style.seen_path(camera): [_SO_FAR]}
    )


def _grid_columns(count: int) -> int:
    """Pictures as large as their column lets them be: it is twice as high as it is wide."""
    return max(1, math.ceil(math.sqrt(count / 2)))


def _axis(start_ns: int, end_ns: int) -> rrb.archetypes.TimeAxis:
    """One for all plots, from the session's beginning to its end: rerun's own keeps the cursor in
    the middle, and so half of each plot empty."""
    start = rr.TimeRangeBoundary.absolute(nanos=start_ns)
    end = rr.TimeRangeBoundary.absolute(nanos=end_ns)
    return rrb.archetypes.TimeAxis(view_range=TimeRange(start=start, end=end))


def _plot(name: str, origin: str, axis: rrb.archetypes.TimeAxis | None) -> rrb.TimeSeriesView:
    legend = rrb.Corner2D.LeftTop
    return rrb.TimeSeriesView(origin=origin, name=name, plot_legend=legend, axis_x=axis)
