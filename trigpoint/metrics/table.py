"""Which value of whose diagnostics is which metric; docs/reference/metrics.md is held to this.

A metric is named once, here. What is in no row keeps its name as a label of `OTHERS`.
"""

from trigpoint.contract.topics import TOPICS

from .metric import LEVEL, REPORTED, Metric

EVERY = "every node"
_QUEUE = f"{{queue:{'|'.join(topic.name for topic in TOPICS)}|odometry .+}}"
_REFUSED = (
    "{reason:wrong_frame|not_planar|no_covariance|too_uncertain|too_old|in_the_future|two_senders|"
    "out_of_order|no_odometry|jump|pull|other_map|not_connected|by_robot}"
)

_RECORDED = Metric("trigpoint_recorded_total", "recorded {key}.total", "messages recorded, by key")
_RECORDING_LOST = Metric(
    "trigpoint_recording_lost_total",
    "file {key}.lost",
    "messages that the disk was too slow for, or that it has no room for",
)
LOST_BESIDE = {_RECORDED.name: _RECORDING_LOST}
"""Counters -> the one of losses that begins with each, by the same labels."""

METRICS: dict[str, tuple[Metric, ...]] = {
    EVERY: (
        Metric("trigpoint_node_level", LEVEL, "0 well, 1 warning, 2 error"),
        Metric(
            "trigpoint_report_timestamp_seconds",
            REPORTED,
            "when these values were read, Unix time; they are read once a second",
        ),
        Metric("trigpoint_build_info", "version", "the program's version", text="version"),
        Metric("trigpoint_start_time_seconds", "started", "the start, Unix time"),
        Metric("trigpoint_uptime_seconds", "uptime", "how long the node has been running"),
        Metric("trigpoint_peers", "peers", "sessions on the bus that it is linked with"),
        Metric(
            "trigpoint_clock_set_by_seconds",
            "clock_set_by",
            "by how much this machine's clock was set and is not followed yet, else absent",
        ),
        Metric(
            "trigpoint_clock_off_by_seconds",
            "clock_off_by",
            "by how much a camera's or robot's clock is ahead of fusion's, where that is more than "
            "is borne, else absent",
        ),
        Metric(
            "trigpoint_clock_offset_seconds",
            "clock_offset_ms",
            "fusion's clock less this machine's, of cameras and robots; absent where fusion does "
            "not answer",
        ),
        Metric(
            "trigpoint_certificate_left_seconds",
            "certificate_days",
            "until the program's certificate runs out; absent on a site without certificates",
        ),
        Metric("trigpoint_sent_total", "sent {key}.total", "messages sent, by key"),
        Metric("trigpoint_received_total", "received {key}.total", "sound ones, by key"),
        Metric("trigpoint_rejected_total", "rejected.total", "messages that do not decode"),
        Metric("trigpoint_unsent_total", "unsent.lost", "messages that could not be sent"),
        Metric("trigpoint_queue_received_total", f"{_QUEUE}.total", "messages into a queue"),
        Metric(
            "trigpoint_queue_dropped_total",
            f"{_QUEUE}.lost",
            "messages lost before they were read: by a full queue, or in transit",
        ),
        Metric("trigpoint_queue_depth", "{queue}.depth", "what waits in a queue"),
        Metric(
            "trigpoint_disk_free_bytes",
            "disk_free_bytes",
            "left on the disk that the node writes to, of recorder and fusion",
        ),
    ),
    "edge": (
        Metric("trigpoint_pictures_total", "pictures.total", "pictures that came"),
        Metric(
            "trigpoint_picture_age_seconds",
            "picture_age_s",
            "since the newest sound, new picture came, or since the start; a frozen one is not new",
        ),
        Metric(
            "trigpoint_pictures_passed_over_total",
            "passed_over.total",
            "pictures left out on purpose, to keep the site's rate",
        ),
        Metric(
            "trigpoint_pictures_skipped_total",
            "pictures.lost",
            "pictures lost, as they came faster than they could be looked at",
        ),
        Metric(
            "trigpoint_pictures_unusable_total",
            "{reason:unreadable|frozen|out_of_order}.lost",
            "pictures that the source spoilt",
        ),
        Metric(
            "trigpoint_source_lost_total",
            "source_lost.total",
            "times that the source of pictures failed or could not be opened",
        ),
        Metric(
            "trigpoint_source_state",
            "source",
            "1 for the state: opening, waiting, running, frozen, unreadable, lost, ended",
            text="state",
        ),
        Metric("trigpoint_stamps_info", "stamps", "1 for how pictures are stamped", text="stamped"),
        Metric("trigpoint_faces_total", "faces.total", "faces of targets found"),
        Metric(
            "trigpoint_detections_given_up_total",
            "given_up.lost",
            "searches of a picture that were ended when its time was over",
        ),
        Metric(
            "trigpoint_detection_seconds", "detection.seconds", "how long pictures were searched"
        ),
        Metric(
            "trigpoint_sighting_delay_seconds",
            "sighting_delay.seconds",
            "from a picture's exposure until its sightings were sent",
        ),
        Metric(
            "trigpoint_background_state",
            "background",
            "1 for what is seen of the still background: learning, still, hidden, suspected",
            text="state",
        ),
        Metric(
            "trigpoint_nudges_total",
            "nudges.total",
            "times that the camera was turned or shifted, as its background shows",
        ),
        Metric(
            "trigpoint_nudged_info",
            "nudged_between",
            "1 for the last time: the stamps of the pictures before and after, ns",
            text="between",
        ),
        Metric(
            "trigpoint_calibration_views",
            "calibration_views",
            "views kept for the command `calibrate`",
        ),
    ),
    "robot": (
        Metric("trigpoint_odometry_total", "odometry.total", "readings taken"),
        Metric(
            "trigpoint_odometry_ahead_of_clock_total",
            "odometry_ahead_of_clock.lost",
            "readings refused, since they are stamped in the future",
        ),
        Metric(
            "trigpoint_odometry_lost_total",
            "odometry_{reason:gaps|out_of_order|impossible|epochs|clock_off}.lost",
            "gaps, readings refused, and counts begun anew",
        ),
        Metric(
            "trigpoint_odometry_irregular_total",
            "odometry_{reason:before_clock|unstamped|not_normalised|no_twist}.total",
            "readings before the firmware's clock is known, and those that lacked something",
        ),
        Metric(
            "trigpoint_odometry_ahead_seconds",
            "odometry_ahead_ms",
            "how far the clock of a robot on the bus is ahead",
        ),
        Metric("trigpoint_corrections_total", "corrections.total", "corrections judged"),
        Metric(
            "trigpoint_corrections_accepted_total",
            "corrections_accepted.total",
            "corrections that the robot took, or the bridge for a robot that takes none",
        ),
        Metric(
            "trigpoint_corrections_refused_total",
            f"corrections_refused_{_REFUSED}.lost",
            "corrections refused by the bridge, or `by_robot`",
        ),
        Metric(
            "trigpoint_corrections_waiting_total",
            "corrections_waiting.total",
            "corrections that waited until enough of them agree on where the robot is",
        ),
        Metric(
            "trigpoint_corrections_missing_total",
            "corrections.lost",
            "corrections that were sent and never came",
        ),
        Metric(
            "trigpoint_corrections_held_total",
            "corrections_held_by_the_clock.lost",
            "corrections not handed on, since this machine's clock disagrees with fusion's",
        ),
        Metric(
            "trigpoint_corrections_unanswered_total",
            "corrections_unanswered.lost",
            "corrections that the robot did not answer",
        ),
        Metric(
            "trigpoint_correction_delay_seconds",
            "correction_delay.seconds",
            "from a sighting's exposure until its correction came to the robot's bridge",
        ),
        Metric(
            "trigpoint_correction_transit_seconds",
            "correction_transit.seconds",
            "from a correction's sending until it came to the robot's bridge",
        ),
        Metric(
            "trigpoint_correction_answer_seconds",
            "correction_answer.seconds",
            "from a correction's writing until the robot's answer",
        ),
        Metric(
            "trigpoint_frames_established_total",
            "frames_established.total",
            "times that the robot was placed anew",
        ),
        Metric(
            "trigpoint_localisation_state",
            "localisation",
            "1 for how the robot stands in the map",
            text="state",
        ),
        Metric("trigpoint_port_open", "port_open", "1 where the port is open"),
        Metric("trigpoint_port_opened_total", "port_opened", "times it was opened"),
        Metric("trigpoint_robot_connected", "connected", "1 where the robot speaks"),
        Metric(
            "trigpoint_robot_connections_total",
            "connections.total",
            "times that the robot said who it is",
        ),
        Metric(
            "trigpoint_firmware_restarts_total",
            "firmware_restarts.lost",
            "restarts of the robot's firmware",
        ),
        Metric(
            "trigpoint_firmware_clock_seconds",
            "firmware_clock_s",
            "the firmware clock's reading, 0 if unknown",
        ),
        Metric(
            "trigpoint_firmware_received_total",
            "firmware_received",
            "frames that the firmware says it received",
        ),
        Metric(
            "trigpoint_firmware_rejected_total",
            "firmware_rejected",
            "frames that the firmware says it rejected",
        ),
        Metric(
            "trigpoint_firmware_clock_round_trip_seconds",
            "clock_round_trip_us",
            "shortest round trip of a question for the firmware's clock",
        ),
        Metric(
            "trigpoint_firmware_clock_drift_ratio",
            "clock_drift_ppm",
            "drift of the firmware's clock, seconds a second",
        ),
        Metric(
            "trigpoint_firmware_clock_jumps_total", "clock_jumps", "jumps of the firmware's clock"
        ),
        Metric(
            "trigpoint_serial_errors_total",
            "serial_{reason:framing|checksum|content}_errors.lost",
            "damaged frames on the line",
        ),
        Metric(
            "trigpoint_serial_frames_missing_total",
            "serial_frames_missing.lost",
            "frames that the robot numbered and that never came",
        ),
    ),
    "fusion": (
        Metric("trigpoint_cameras_located", "cameras_located", "cameras in the network"),
        Metric(
            "trigpoint_cameras_undetermined",
            "cameras_undetermined",
            "cameras of the site file that are not located",
        ),
        Metric(
            "trigpoint_cameras_worst_sigma_meters",
            "worst_sigma_m",
            "sigma of the worst located camera's place, root of the trace; NaN where none is",
        ),
        Metric(
            "trigpoint_observations_waiting",
            "waiting",
            "sightings and readings that wait for each other",
        ),
        Metric(
            "trigpoint_left_out_total",
            "left_out.{reason}.total",
            "messages that are not used; those of a robot that stands still are no loss",
        ),
        Metric("trigpoint_faces_received_total", "faces.total", "faces in sightings"),
        Metric(
            "trigpoint_sighting_transit_seconds",
            "sighting_transit.seconds",
            "from sightings' sending until they came to fusion",
        ),
        Metric(
            "trigpoint_fusion_seconds",
            "fusion.seconds",
            "from a sighting's coming to fusion until its correction was sent, the wait for the "
            "robot's odometry included",
        ),
        Metric(
            "trigpoint_solving_seconds", "solving.seconds", "how long solving everything anew took"
        ),
        Metric(
            "trigpoint_last_solving_seconds",
            "last_solving_s",
            "how long solving everything anew took the last time; NaN before that",
        ),
        Metric(
            "trigpoint_checkpoint_lost_total",
            "checkpoint.lost",
            "messages that could not be kept for the next start",
        ),
    ),
    "recorder": (
        _RECORDED,
        _RECORDING_LOST,
    ),
    "view": (
        Metric("trigpoint_drawn_total", "drawn.total", "messages drawn"),
        Metric("trigpoint_drawing_lost_total", "drawing.lost", "messages dropped for newer ones"),
    ),
}
"""Whose diagnostics -> the rows of their values."""

OTHERS = (
    Metric("trigpoint_other_total", "{name}.total", "further counters, by name"),
    Metric("trigpoint_other_lost_total", "{name}.lost", "further losses, by name"),
    Metric("trigpoint_other_value", "{name}", "further gauges, by name"),
)
_IDENTITY = frozenset({"contract", "node", "process", "session"})


def is_left_out(value: str) -> bool:
    """Whether a value is no metric: who the node is, and rates, which Prometheus works out."""
    return value in _IDENTITY or value.endswith(".rate")


def metric_of(kind: str, value: str) -> tuple[Metric, dict[str, str]]:
    """The metric of a value in the diagnostics of a node of this kind, and its own labels."""
    for metric in (*METRICS.get(kind, ()), *METRICS[EVERY], *OTHERS):
        labels = metric.match(value)
        if labels is not None:
            return metric, labels
    raise AssertionError("the last of OTHERS takes every name")
