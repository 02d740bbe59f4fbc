"""nuScenes' parts by scene, as its devkit publishes them."""

from farfield.vocabulary.nuscenes_splits import official_parts

MINI = {
    "train": ["0061", "0553", "0655", "0757", "0796", "1077", "1094", "1100"],
    "val": ["0103", "0916"],
}
"""Every scene of ``v1.0-mini``: python-sdk/nuscenes/utils/splits.py, ``mini_train`` and ``mini_val``."""


def test_the_ten_scenes_of_mini_are_parted_as_published() -> None:
    scenes = [f"scene-{number}" for part in MINI.values() for number in part]
    expected = {part: [f"scene-{number}" for number in numbers] for part, numbers in MINI.items()}
    assert official_parts("v1.0-mini", scenes) == expected


def test_two_scenes_of_mini_train_are_for_validation_in_trainval() -> None:
    assert official_parts("v1.0-trainval", ["scene-0553", "scene-0796"]) == {
        "train": [],
        "val": ["scene-0553", "scene-0796"],
    }
