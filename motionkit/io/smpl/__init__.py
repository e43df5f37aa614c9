"""Motions of SMPL bodies (AMASS, UESTC, …), with joints from a body model or the mean shape."""
