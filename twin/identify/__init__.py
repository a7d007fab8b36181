"""Numbers from recordings: excitation, fits of springs and dampers, rigid-body least squares."""
