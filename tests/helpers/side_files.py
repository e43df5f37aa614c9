"""Small valid files of the kinds that lie beside motions, and of those that a user gives."""

from tests.helpers.format_samples import ASF

CAPTIONS = (
    b"file,caption,captions,fps\n"
    b'take.bvh,"walks, slowly","[""walks"", {""text"": ""runs"", ""start_seconds"": 1}]",30\n'
)
RULES = b'[[rule]]\nfiles = "walk*.bvh"\nstated = 60\nfps = 120\nsource = "a letter"\n'

# Format whose source it lies beside, its name there, and what it holds where all is well.
BESIDE = {
    "annotations": ("bvh", "captions.csv", CAPTIONS),
    "manifest": ("joints-npy", "motions.json", b'{"fps": "30000/1001", "layout": "smpl22", "unit_metres": 1.0}'),
    "cuts": ("100style", "Frame_Cuts.csv", b"STYLE_NAME,FW_START,FW_STOP\nOld,0,3\n"),
    "styles": ("100style", "Dataset_List.csv", b"Style Name,Description\nOld,Old man\n"),
    "texts": ("humanml3d", "texts/000001.txt", b"a person walks#a/DET person/NOUN walk/VERB#0.0#0.0\n"),
    "split": ("humanml3d", "train.txt", b"000001\n"),
    "licence": ("bvh", "LICENSE", b"MIT License\n"),
    "skeleton": ("asfamc", "07.asf", ASF.encode()),
}
