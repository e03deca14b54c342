"""Find a target's faces in a folder of pictures (or a video, or a bag)."""

import sys

import trigpoint as tp

folder, target = sys.argv[1:]
for name, sightings in tp.detect_all(folder, target):
    for face in sightings.faces:
        u, v = face.pixels.mean(axis=0)
        print(f"{name}: face {face.face}, {len(face.corners)} corners about ({u:.0f}, {v:.0f})")
