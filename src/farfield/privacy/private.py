"""A data set whose images are covered as they are read."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from jaxtyping import UInt8

from farfield.frame import Annotation, Frame
from farfield.frame.record import Lazy
from farfield.geometry.cameras import Camera
from farfield.privacy.context import in_context, vehicles_px
from farfield.privacy.covering import covered
from farfield.privacy.hits import PLATE, ImageBoxes
from farfield.privacy.looking import AnonymizeOptions

_Picture = UInt8[np.ndarray, "height width 3"]


@dataclass(frozen=True)
class Anonymized:
    """Covers faces and number plates in a frame's images, each image by itself: ``dataset.mapped(Anonymized())``.

    Weak boxes of faces are covered too, for no track says which of them are faces; weak ones of plates only within
    vehicles, where the frame has boxes and the camera a calibration. What a detector misses stays seen.
    :func:`~farfield.privacy.anonymise` follows what it found over the pictures of a drive.

    Args:
        chosen: How.
    """

    chosen: AnonymizeOptions = field(default_factory=AnonymizeOptions)

    def __call__(self, frame: Frame) -> Frame:
        """The frame with covered images."""
        images, chosen = frame.images, self.chosen
        loaders = {
            name: images.loader(name) if isinstance(images, Lazy) else partial(images.__getitem__, name)
            for name in images
        }
        seen = {
            name: partial(_seen, load, chosen, frame.load_annotation, frame.cameras.get(name))
            for name, load in loaders.items()
        }
        return replace(frame, images=Lazy(seen))


def _seen(
    load: Callable[[], _Picture],
    chosen: AnonymizeOptions,
    annotation: Callable[[], Annotation] | None,
    camera: Camera | None,
) -> _Picture:
    image = load()
    hits = ImageBoxes.joined([finder(image) for finder in chosen.finders()])
    if (hits.kind == PLATE).any():
        vehicles = np.zeros((0, 4))
        if annotation is not None and camera is not None:
            vehicles = vehicles_px(annotation().boxes, camera)
        hits = in_context(hits, vehicles, chosen.linking.strong)
    return covered(image, hits.within(image.shape[1], image.shape[0]), chosen.how, np.random.default_rng())
