"""The agent of a camera: pictures in, sightings out."""
