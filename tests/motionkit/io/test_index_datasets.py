"""All spellings of a file of AMASS have one key."""

import pytest

from motionkit.io.indexes import dataset_of, file_key


@pytest.mark.parametrize(
    ("index", "file"),
    [
        ("KIT/3/kick_high_left02_poses.npy", "KIT/3/kick_high_left02_poses.npz"),
        ("KIT/3/kick_high_left02_poses.npy", "smplh/KIT/KIT/3/kick_high_left02_poses.npz"),
        ("KIT/3/kick_high_left02_poses.npy", "KIT/3/kick_high_left02_stageii.npz"),
        ("CMU/01/01_01_poses.npy", "cmu/01/01_01.amc"),
        ("BioMotionLab_NTroje/rub110/0001_treadmill_fast_poses.npy", "BMLrub/rub110/0001_treadmill_fast_stageii.npz"),
        ("BMLrub/BioMotionLab_NTroje/rub110/0030_rom_poses.npz", "BMLrub/rub110/0030_rom_stageii.npz"),
        ("ACCAD/F1_c3d/C19 -  run to hop to walk_poses.npy", "ACCAD/F1_c3d/C19_-__run_to_hop_to_walk_stageii.npz"),
        ("DFaust_67/50022/50022_punching_poses.npy", "DFaust/50022/50022_punching_stageii.npz"),
        ("MPI_HDM05/mm/HDM_mm_08-01_01_120_poses.npy", "HDM05/mm/HDM_mm_08-01_01_120_stageii.npz"),
        ("MPIHDM05/MPI_HDM05/dg/HDM_dg_03-05_01_120_poses.npz", "MPI_HDM05/dg/HDM_dg_03-05_01_120_poses.npz"),
        ("MPI_Limits/03099/op3_poses.npy", "PosePrior/03099/op3_stageii.npz"),
        ("MPI_mosh/50020/ankles_poses.npy", "MoSh/50020/ankles_stageii.npz"),
        ("SSM_synced/20161014_50033/ATUSquat_sync_poses.npy", "SSM/20161014_50033/ATUSquat_sync_stageii.npz"),
        ("Transitions_mocap/mazen_c3d/crawl_stand_poses.npy", "Transitions/mazen_c3d/crawl_stand_stageii.npz"),
        ("TCD_handMocap/ExperimentDatabase/a_poses.npy", "TCDHands/ExperimentDatabase/a_stageii.npz"),
        (
            "Eyes_Japan_Dataset/yamaoka/tennis-15-first service-yamaoka_poses.npy",
            "EyesJapanDataset/yamaoka/tennis-15-first_service-yamaoka_stageii.npz",
        ),
        ("humanact12/humanact12/P11G01R02F1812T1847A0402.npy", "humanact12/P11G01R02F1812T1847A0402.npy"),
    ],
)
def test_spellings_of_one_file(index, file):
    assert file_key(index.split("/")) == file_key(file.split("/"))


@pytest.mark.parametrize(
    ("one", "other"),
    [
        ("KIT/3/kick01_poses.npz", "KIT/4/kick01_poses.npz"),
        ("KIT/3/kick01_poses.npz", "EKUT/3/kick01_poses.npz"),
        ("KIT/3/kick01_poses.npz", "KIT/3/kick0_1_poses.npz"),
        ("mine/3/kick01.npz", "3/kick01.npz"),
        ("KIT/3/kick_1.5_poses.npz", "KIT/3/kick_1.npz"),
    ],
)
def test_files_that_differ(one, other):
    assert file_key(one.split("/")) != file_key(other.split("/"))


def test_trims_are_those_of_the_published_code():
    trims = {"Eyes_Japan_Dataset": 60, "MPI_HDM05": 60, "TotalCapture": 20, "MPI_Limits": 20, "Transitions_mocap": 10}
    for name in (*trims, "KIT", "CMU", "BMLmovi", "HumanEva"):
        found = dataset_of((name, "a", "b.npz"))
        assert found is not None
        assert found[0].trim_frames == trims.get(name, 0)


@pytest.mark.parametrize(
    ("file", "fps"),
    [
        ("SSM_synced/20160330_03333/walking_poses.npy", 59.9999885),
        ("SSM_synced/20161014_50033/dance_sync_poses.npy", 120.0),
        ("TotalCapture/s3/walking2_poses.npy", 60.0),
        ("humanact12/humanact12/P11G01R02F1812T1847A0402.npy", 20.0),
        ("CMU/36/36_15_poses.npy", None),
    ],
)
def test_what_the_published_code_saw_where_files_may_say_otherwise(file, fps):
    parts = file.split("/")
    found = dataset_of(parts)
    assert found is not None and found[0].seen_fps_of(parts) == fps


def test_a_file_is_no_dataset():
    assert dataset_of(("a", "CMU")) is None
    assert dataset_of(("CMU",)) is None
