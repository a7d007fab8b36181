"""Numbers from recordings: excitation, regressor, base parameters, rigid-body least squares."""
