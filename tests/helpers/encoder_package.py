"""A package with an encoder, as somebody else might install one."""

from pathlib import Path

LEARNT = """
from motionkit.fields.interpolation import INTERPOLATORS
from motionkit.core.skeleton import SMPL22

class Learnt:
    name, longest_gap_seconds, reach_seconds = "Learnt", 0.2, 0.1
    def encode(self, observation, **reach):
        assert observation.skeleton.joint_names == SMPL22.joint_names
        return INTERPOLATORS["hold"].encode(observation, **reach)

def load(run):
    (run / "learnt" / "summary.json").read_text()
    return Learnt()

ENCODERS = {"learnt": load}
"""


def write_encoder_package(folder: Path) -> tuple[Path, Path]:
    """The folder that the package is imported from, and a folder of runs of which one has its encoder trained.

    The encoder is for 22 joints and holds poses.
    """
    metadata = folder / "site" / "learnt-1.0.dist-info"
    metadata.mkdir(parents=True)
    (folder / "site" / "learnt_encoder.py").write_text(LEARNT, encoding="utf-8")
    (metadata / "METADATA").write_text("Metadata-Version: 2.1\nName: learnt\nVersion: 1.0\n", encoding="utf-8")
    (metadata / "entry_points.txt").write_text("[motionkit.plugins]\nlearnt = learnt_encoder\n", encoding="utf-8")
    (folder / "runs" / "nano" / "learnt").mkdir(parents=True)
    (folder / "runs" / "nano" / "learnt" / "summary.json").write_text("{}", encoding="utf-8")
    return folder / "site", folder / "runs"
