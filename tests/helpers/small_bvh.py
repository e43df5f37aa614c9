"""A BVH file small enough to read, and to break."""

NUM_CHANNELS = 6 + 3 * 5


def bvh_text(num_frames: int = 5, frame_time: str = "0.0333333", num_channels: int = NUM_CHANNELS) -> str:
    """A BVH file of six joints that moves along x."""
    header = """HIERARCHY
ROOT Hips
{
  OFFSET 0 90 0
  CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation
  JOINT Spine
  {
    OFFSET 0 30 0
    CHANNELS 3 Zrotation Xrotation Yrotation
    JOINT Head
    {
      OFFSET 0 40 0
      CHANNELS 3 Zrotation Xrotation Yrotation
      End Site
      {
        OFFSET 0 10 0
      }
    }
  }
  JOINT LeftUpLeg
  {
    OFFSET 10 0 0
    CHANNELS 3 Zrotation Xrotation Yrotation
    JOINT LeftLeg
    {
      OFFSET 0 -45 0
      CHANNELS 3 Zrotation Xrotation Yrotation
      JOINT LeftFoot
      {
        OFFSET 0 -45 0
        CHANNELS 3 Zrotation Xrotation Yrotation
        End Site
        {
          OFFSET 0 0 15
        }
      }
    }
  }
}
"""
    rows = [
        " ".join(f"{value:.4f}" for value in [2.0 * frame, 90.0, *([0.0] * (num_channels - 2))])
        for frame in range(num_frames)
    ]
    return f"{header}MOTION\nFrames: {num_frames}\nFrame Time: {frame_time}\n" + "\n".join(rows) + "\n"


def two_joints_bvh(rows: list[str]) -> str:
    """A BVH file of two joints at 100 fps with these rows of nine numbers."""
    header = """HIERARCHY
ROOT Hips
{
  OFFSET 0 90 0
  CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation
  JOINT Head
  {
    OFFSET 0 70 0
    CHANNELS 3 Zrotation Xrotation Yrotation
    End Site
    {
      OFFSET 0 10 0
    }
  }
}
"""
    return f"{header}MOTION\nFrames: {len(rows)}\nFrame Time: 0.01\n" + "\n".join(rows) + "\n"
