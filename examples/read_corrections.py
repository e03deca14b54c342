"""Read the corrections of all robots off the bus with plain zenoh, and nothing of Trigpoint's.

A key is a ROS 2 topic's name, a payload its CDR: geometry_msgs/msg/PoseWithCovarianceStamped. Of a
site without [bus] the programs meet on loopback alone; give `listen` of one as the endpoint.
"""

import json
import math
import struct
import sys

import zenoh

site, endpoint = sys.argv[1:]
config = zenoh.Config()
config.insert_json5("connect/endpoints", json.dumps([endpoint]))
config.insert_json5("scouting/multicast/enabled", "false")
with (
    zenoh.open(config) as session,
    session.declare_subscriber(f"{site}/robot/*/correction") as subscriber,
):
    for sample in subscriber:
        payload = sample.payload.to_bytes()
        seconds, nanoseconds, length = struct.unpack_from("<iII", payload, 4)
        start = 4 + -(-(12 + length) // 8) * 8  # after the frame's name doubles are aligned
        x, y, _z, _qx, _qy, qz, qw, *covariance = struct.unpack_from("<43d", payload, start)
        sigma_cm = 100 * math.sqrt(covariance[0] + covariance[7])
        robot, heading = str(sample.key_expr).split("/")[2], 2 * math.atan2(qz, qw)
        print(
            f"{robot} was at ({x:.3f}, {y:.3f}) m ± {sigma_cm:.2f} cm, {heading:+.3f} rad, "
            f"at {seconds}.{nanoseconds:09d} s",
            flush=True,
        )
