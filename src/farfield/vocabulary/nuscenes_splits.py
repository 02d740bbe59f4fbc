"""Which scenes of nuScenes are for validation, as published in nuscenes-devkit (python-sdk/nuscenes/utils/splits.py).

The other scenes of ``v1.0-trainval`` and of ``v1.0-mini`` are for training, all of ``v1.0-test`` for testing.
"""

import re

_VALIDATION = (
    "3 12-18 35-36 38-39 92-110 221 268-278 329-332 344-346 519-524 552-565 625-627 629-630 632-638 770-771 775 "
    "777-778 780-784 794-800 802 904-917 919-931 962-963 966-969 971-972 1059-1073"
)
VALIDATION_SCENES: frozenset[int] = frozenset(
    number for span in _VALIDATION.split() for number in range(int(span.split("-")[0]), int(span.split("-")[-1]) + 1)
)
"""Numbers of the 150 scenes of the part ``val`` of ``v1.0-trainval``."""
MINI_VALIDATION_SCENES: frozenset[int] = frozenset({103, 916})
"""Numbers of the scenes of ``mini_val``; two more of trainval's, 553 and 796, are in ``mini_train``."""
_NAME = re.compile(r"scene-(\d{4})")


def official_parts(version: str, scenes: list[str]) -> dict[str, list[str]]:
    """Scenes by part as nuScenes' authors published them; empty for other versions and names.

    Args:
        version: The folder of the tables.
        scenes: Names of all scenes there.

    >>> official_parts("v1.0-mini", ["scene-0061", "scene-0103"])
    {'train': ['scene-0061'], 'val': ['scene-0103']}
    """
    numbers = {name: int(match.group(1)) for name in scenes if (match := _NAME.fullmatch(name))}
    if version not in ("v1.0-mini", "v1.0-trainval", "v1.0-test") or len(numbers) < len(scenes):
        return {}
    if version == "v1.0-test":
        return {"test": list(numbers)}
    validation = MINI_VALIDATION_SCENES if version == "v1.0-mini" else VALIDATION_SCENES
    return {
        "train": [name for name, number in numbers.items() if number not in validation],
        "val": [name for name, number in numbers.items() if number in validation],
    }
