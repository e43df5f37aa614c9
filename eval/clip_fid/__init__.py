"""clip-FID: its definition, the feature sets it can be computed on, their calibration."""
