"""PA-HiRes' tasks: interpolation, in-betweening, extrapolation."""
