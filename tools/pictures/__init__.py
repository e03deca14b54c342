"""`trigpoint detect` and `intrinsics`: targets and lenses from pictures in files and bags."""
