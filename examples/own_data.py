"""Make a session of one's own data and calibrate it.

The folder has site.toml and the files that it names, odometry.tum (rows of t x y z qx qy qz qw;
seconds and metres) and pictures/CAMERA/NANOSECONDS.png, all by one clock.
"""

import sys
from pathlib import Path

import trigpoint as tp

folder = Path(sys.argv[1])
target, seen = tp.read_target(folder / "target.toml"), {}
for camera in (folder / "pictures").iterdir():
    pictures = camera.glob("*.png")
    seen[camera.name] = [tp.detect(p, target, stamp_ns=int(p.stem)) for p in pictures]
way, site = tp.read_trajectory(folder / "odometry.tum"), folder / "site.toml"
session = tp.write_session(folder / "session.mcap", site=site, odometry={"r1": way}, sightings=seen)
for name, camera in tp.calibrate(session).network.cameras.items():
    print(f"{name}: {camera.status}, sigma {100 * camera.position_sigma:.2f} cm")
