"""Procedural human motions with exact ground truth at any time, for the embedded demo corpus and the tests.

`perform` gives a random performance of named actions by a body; the result is a `MotionField`, so
`motionkit.fields.motion_field.to_motion(field, fps)` samples it at any framerate.
"""

from motionkit.synthetic.bodies import Body, draw_body, make_body
from motionkit.synthetic.performance import ACTIONS, SyntheticMotion, perform

__all__ = ["ACTIONS", "Body", "SyntheticMotion", "draw_body", "make_body", "perform"]
