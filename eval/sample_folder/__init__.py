"""Any other system's samples: a folder of motions, whatever wrote them (docs/samples.md)."""

from eval.sample_folder.folder import SampleFolder, SampleFolderError
from eval.sample_folder.reading import SampleOptions, read_sample_folder

__all__ = ["SampleFolder", "SampleFolderError", "SampleOptions", "read_sample_folder"]
