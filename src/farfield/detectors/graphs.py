"""A detector's dense trunk recorded once as a CUDA graph: one call a frame instead of one a layer."""

import torch
from torch import Tensor, nn

from farfield.detectors.runtime import Detector
from farfield.errors import ConfigError
from farfield.frame import Cloud, Frame


class Graphed(nn.Module):
    """A module recorded once as a CUDA graph, and replayed for inputs of the recorded shape.

    Args:
        module: What is recorded, in evaluation mode; it computes inputs of other shapes itself.
        image: An input of it, on a GPU.
    """

    def __init__(self, module: nn.Module, image: Tensor) -> None:
        super().__init__()
        self.module = module  # the graph reads its weights
        self.image = image.clone()
        stream = torch.cuda.Stream(image.device)
        stream.wait_stream(torch.cuda.current_stream(image.device))
        with torch.no_grad(), torch.cuda.stream(stream):
            for _ in range(3):
                module(self.image)
        torch.cuda.current_stream(image.device).wait_stream(stream)
        self.graph = torch.cuda.CUDAGraph()
        with torch.no_grad(), torch.cuda.graph(self.graph):
            self.out = module(self.image)

    def forward(self, image: Tensor) -> Tensor:
        """The output for an image; the next call overwrites it."""
        if image.shape != self.image.shape or image.dtype != self.image.dtype or torch.is_grad_enabled():
            made: Tensor = self.module(image)
            return made
        self.image.copy_(image)
        self.graph.replay()
        return self.out


def record_trunk(detector: Detector, frame: Frame | Cloud) -> None:
    """Record a detector's dense trunk from a frame, in place; batches of as many frames replay it from then on.

    Args:
        detector: A PointPillars, SECOND or VoxelNet on a GPU.
        frame: Any frame that it can read.

    Raises:
        ConfigError: If the detector has no dense trunk, or is not on a GPU.
    """
    trunk = getattr(detector.network, "backbone", None)
    if detector.device.type != "cuda" or not isinstance(trunk, nn.Module):
        got = f"{detector.name} on {detector.device}"
        raise ConfigError(f"record_trunk: expected PointPillars, SECOND or VoxelNet on a GPU; got {got}")
    images: list[Tensor] = []
    hook = trunk.register_forward_pre_hook(lambda _, given: images.append(given[0]))
    try:
        detector(frame)
    finally:
        hook.remove()
    if not images or not torch.is_tensor(images[0]):
        raise ConfigError(f"record_trunk: expected a trunk that reads a dense map; {detector.name} has none")
    detector.network.backbone = Graphed(trunk, images[0])
