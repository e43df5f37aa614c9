"""SMPL bodies: AMASS and UESTC, joints from a body model or the mean shape."""
