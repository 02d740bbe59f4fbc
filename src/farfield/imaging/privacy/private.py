"""A data set whose images are covered as they are read."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from jaxtyping import UInt8

from farfield.frame import Frame
from farfield.frame.lazy import Lazy
from farfield.imaging.privacy.covering import covered
from farfield.imaging.privacy.hits import Hits
from farfield.imaging.privacy.looking import Anonymising

_Picture = UInt8[np.ndarray, "height width 3"]


@dataclass(frozen=True)
class Private:
    """Covers the faces in a frame's images, each image by itself: ``dataset.mapped(Private())``.

    Weak boxes are covered too, for no track says which of them are faces; what the detector misses stays seen.
    :func:`~farfield.imaging.privacy.anonymise` follows faces over the pictures of a drive.

    Args:
        chosen: How.
    """

    chosen: Anonymising = field(default_factory=Anonymising)

    def __call__(self, frame: Frame) -> Frame:
        """The frame with covered images."""
        images, chosen = frame.images, self.chosen
        loaders = {
            name: images.loader(name) if isinstance(images, Lazy) else partial(images.__getitem__, name)
            for name in images
        }
        return replace(frame, images=Lazy({name: partial(_seen, load, chosen) for name, load in loaders.items()}))


def _seen(load: Callable[[], _Picture], chosen: Anonymising) -> _Picture:
    image = load()
    hits = Hits.joined([finder(image) for finder in chosen.finders()])
    return covered(image, hits.within(image.shape[1], image.shape[0]), chosen.how, np.random.default_rng())
