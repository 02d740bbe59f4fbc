"""Transposed convolution as an ordinary one, beside PyTorch's own."""

import pytest

torch = pytest.importorskip("torch")

from torch import nn

from farfield.detectors.layers import Upsampling, fold_batch_norm


def transposed(stride: int, *, overlap: bool, **settings) -> nn.ConvTranspose2d:
    torch.manual_seed(stride)
    kernel, padding = (3 * stride, stride) if overlap else (stride, 0)
    return nn.ConvTranspose2d(5, 7, kernel, stride, padding, **settings).double()


@pytest.mark.parametrize("overlap", [False, True])
@pytest.mark.parametrize("stride", [1, 2, 3, 4])
def test_it_is_pytorchs_transposed_convolution(stride, overlap):
    theirs = transposed(stride, overlap=overlap)
    ours = Upsampling.of(theirs)
    image = torch.randn(2, 5, 6, 4, dtype=torch.float64)
    torch.testing.assert_close(ours(image), theirs(image), rtol=1e-12, atol=1e-12)
    assert sum(p.numel() for p in ours.parameters()) == 5 * 7 * theirs.kernel_size[0] ** 2 + 7 * stride**2


@pytest.mark.parametrize(
    ("layer", "fits"),
    [
        (transposed(2, overlap=True), True),
        (transposed(2, overlap=False, bias=False), True),
        (nn.ConvTranspose2d(4, 4, 2, 2, groups=2), False),
        (nn.ConvTranspose2d(4, 4, 3, 2), False),
        (nn.ConvTranspose2d(4, 4, 2, 2, output_padding=1), False),
        (nn.ConvTranspose2d(4, 4, 6, 2, 2, dilation=2), False),
        (nn.ConvTranspose2d(4, 4, (2, 4), (2, 4)), False),
        (nn.Conv2d(4, 4, 2, 2), False),
    ],
)
def test_it_says_what_it_can_express(layer, fits):
    assert Upsampling.fits(layer) is fits


@pytest.mark.parametrize("bias", [False, True])
@pytest.mark.parametrize("ours", [False, True])
def test_a_normalisation_after_it_folds_into_it(bias, ours):
    layer, norm = transposed(2, overlap=True, bias=bias), nn.BatchNorm2d(7).double()
    for values in (norm.running_mean, norm.running_var, norm.weight.data, norm.bias.data):
        nn.init.uniform_(values, 0.5, 1.5)
    model = nn.Sequential(Upsampling.of(layer) if ours else layer, norm).eval()
    folded = fold_batch_norm(model)
    assert isinstance(folded[0], Upsampling)
    assert isinstance(folded[1], nn.Identity)
    image = torch.randn(2, 5, 6, 4, dtype=torch.float64)
    torch.testing.assert_close(folded(image), model(image), rtol=1e-12, atol=1e-12)


def test_its_weights_begin_as_those_of_a_transposed_convolution():
    torch.manual_seed(0)
    theirs, ours = nn.ConvTranspose2d(16, 32, 12, 4, 4), Upsampling(16, 32, 4, overlap=True)
    assert ours.conv.weight.abs().max() <= 1 / (32 * 12**2) ** 0.5
    assert abs(ours.conv.weight.std() / theirs.weight.std() - 1) < 0.02
