"""Whether the model of faces is here, in the environment or in its package."""

from importlib.util import find_spec


def has_face_model() -> bool:
    """Whether faces can be looked for: the model and OpenCV are installed."""
    from farfield.errors import FarfieldError
    from farfield.privacy.detectors import face_model_path

    try:
        return find_spec("cv2") is not None and face_model_path().is_file()
    except FarfieldError:
        return False
