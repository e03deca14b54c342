"""Make a session of one's own data and calibrate it.

The folder has site.toml, the files that it names, odometry.csv (rows of nanoseconds,x,y,heading;
metres and radians) and pictures/CAMERA/NANOSECONDS.png, by one clock.
"""

import sys
from pathlib import Path

import numpy as np

import trigpoint as tp

folder = Path(sys.argv[1])
stamps_ns = np.loadtxt(folder / "odometry.csv", delimiter=",", usecols=0, dtype=np.int64)
x, y, heading = np.loadtxt(folder / "odometry.csv", delimiter=",", usecols=(1, 2, 3), unpack=True)
target = tp.read_target(folder / "target.toml")
seen = {
    camera.name: [tp.detect(p, target, stamp_ns=int(p.stem)) for p in camera.glob("*.png")]
    for camera in (folder / "pictures").iterdir()
}
way = tp.Trajectory(stamps_ns, tp.Pose.planar(x, y, heading))
session = tp.write_session(
    folder / "session.mcap", site=folder / "site.toml", odometry={"r1": way}, sightings=seen
)
for name, camera in tp.calibrate(session).network.cameras.items():
    print(f"{name}: {camera.status}, sigma {100 * camera.position_sigma:.2f} cm")
