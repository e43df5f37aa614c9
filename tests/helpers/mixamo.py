"""What Mixamo calls the joints of SMPL."""

SPINE = {"pelvis": "Hips", "spine1": "Spine", "spine2": "Spine1", "spine3": "Spine2", "neck": "Neck", "head": "Head"}
LIMBS = {"hip": "UpLeg", "knee": "Leg", "ankle": "Foot", "foot": "ToeBase", "collar": "Shoulder", "shoulder": "Arm"}
LIMBS |= {"elbow": "ForeArm", "wrist": "Hand"}


def mixamo_name(joint: str) -> str:
    """Without the prefix that its files have."""
    side, _, limb = joint.rpartition("_")
    return SPINE[joint] if joint in SPINE else side.capitalize() + LIMBS[limb]
