"""Any other system's samples: a folder of motions, whatever wrote them (docs/samples.md)."""

from eval.sample_folder.folder import SampleFolder, SampleFolderError
from eval.sample_folder.manifest import MANIFEST, SampleOptions
from eval.sample_folder.reading import read_sample_folder

__all__ = ["MANIFEST", "SampleFolder", "SampleFolderError", "SampleOptions", "read_sample_folder"]
