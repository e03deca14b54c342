"""Calibrate a session; print each camera's sigma and its error against the truth beside it."""

import sys

import trigpoint as tp

folder = sys.argv[1]
network = tp.calibrate(folder).network
errors = network.errors(f"{folder}/truth.json").cameras
for name, camera in network.cameras.items():
    if camera.status == "located":
        sigma_cm, error_cm = 100 * camera.position_sigma, 100 * errors[name].position
        print(f"{name}: sigma {sigma_cm:.2f} cm, error {error_cm:.2f} cm")
    else:
        print(f"{name}: {camera.status}; {'; '.join(camera.undetermined)}")
