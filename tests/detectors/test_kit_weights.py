"""Checkpoints of K-Radar's kit: each layer's output is the plain dense computation's; every odd name and shape is told.

On generated checkpoints: no real one was at hand.
"""

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from kit_rtnh import KitRTNH, published_boxes, wide_boxes
from small import batch_of

from farfield.detectors.kradar.kit_weights import import_rtnh
from farfield.detectors.weights import load_weights, save_weights
from farfield.errors import ConfigError

SMALL = {"widths": (6, 8, 10), "neck": 7, "cell": 5}
LAYERS = {"published": 20, "wide": 24}
LOW = (0.0, -1.6, -2.0)


def settings_of(layers):
    """A region of 3.2 x 3.2 m, 8 x 8 cells, of so many layers."""
    return {"grid": {"range_m": 3.2, "half_width_m": 1.6, "z_min_m": -2.0, "z_max_m": round(-2 + 0.4 * layers, 1)}}


def points_of(form, layers, rng, columns=4):
    """Points of the kit's clouds: centres of cells half a cell below, one a cell; some share cells in the wide form."""
    place = np.argwhere(rng.random((8, 8, layers)) < 0.12)
    xyz = np.array(LOW) + 0.4 * place - (0.2 if form == "published" else -0.2)
    rows = np.column_stack([xyz, rng.uniform(0, 2, (len(xyz), columns - 3))])
    if form == "wide":
        more = rows[rng.integers(0, len(rows), len(rows))]
        rows = np.concatenate([rows, more + np.concatenate([rng.uniform(-0.15, 0.15, 3), [0.5] * (columns - 3)])])
    return rows.astype(np.float32)


def saved(path, state, **rest):
    torch.save({"model_state_dict": state, "epoch": 10, **rest} if rest else state, path)
    return path


def layers_of(network, points):
    """What each layer of ours gives, as the kit names and lays it out."""
    outputs, backbone = {}, network.backbone

    def keep(name):
        def hook(_, inputs, output):
            del inputs
            dense = output if isinstance(output, torch.Tensor) else output.dense()
            outputs[name] = dense.transpose(-1, -2)  # x, y to y, x

        return hook

    named = {"input_conv": network.encoder}
    for i, (stage, column) in enumerate(backbone._branches()):
        named |= dict(zip((f"spconv{i}", f"subm{i}a", f"subm{i}b"), stage, strict=True))
        named |= {f"toBEV{i}": column, f"convtrans2d{i}": backbone.neck.layers[i]}
    hooks = [module.register_forward_hook(keep(name)) for name, module in named.items()]
    with torch.no_grad():
        maps = network(batch_of(torch.from_numpy(points)))
    for hook in hooks:
        hook.remove()
    return outputs, maps


def compared(kit, path, layout, rng, **options):
    """The imported network, its maps and the oracle's outputs, whose layers agree to 1e-5."""
    network, report = import_rtnh(saved(path, kit.saved(layout), **options), settings=settings_of(kit.layers))
    network.backbone.execution = "sparse"
    points = points_of(kit.form, kit.layers, rng, kit.input)
    ours, maps = layers_of(network, points)
    theirs = kit.outputs(points, LOW, (kit.layers, 8, 8))
    assert set(ours) == {name for name in theirs if not name.startswith("conv_")}
    for name, output in ours.items():
        assert theirs[name].abs().max() > 0.1, name
        torch.testing.assert_close(
            output.double(), theirs[name], rtol=1e-5, atol=1e-5, msg=lambda m, n=name: f"{n}: {m}"
        )
    return network, report, maps, theirs


def head_maps(network, maps):
    """Each output of the head over y, x, in the kit's order of channels."""
    nx, ny = network.head.anchors.nx, network.head.anchors.ny
    parts = [map[0].reshape(nx, ny, -1).permute(2, 1, 0)[None] for map in maps]
    return dict(
        zip(
            ("conv_cls", "conv_reg") if len(parts) == 2 else ("conv_cls", "conv_box", "conv_dir_cls"),
            parts,
            strict=True,
        )
    )


@pytest.mark.parametrize("layout", ["1.x", "2.x", "2.x native"])
@pytest.mark.parametrize("form", ["published", "wide"])
def test_every_layer_computes_what_the_dense_one_does(tmp_path, form, layout, rng):
    kit = KitRTNH(form, layers=LAYERS[form], **SMALL)
    network, report, maps, theirs = compared(kit, tmp_path / "model_10.pt", layout, rng)
    for name, output in head_maps(network, maps).items():
        torch.testing.assert_close(output.double(), theirs[name], rtol=1e-5, atol=1e-5)
    assert set(report.mapped) | set(report.ignored) == set(kit.state)
    assert set(report.mapped.values()) == {k for k in network.state_dict() if "num_batches" not in k}


@pytest.mark.slow  # 15 million weights
@pytest.mark.parametrize("form", ["published", "wide"])
def test_layers_of_the_published_shapes_compute_what_the_dense_ones_do(tmp_path, form, rng):
    kit = KitRTNH(form, layers=LAYERS[form])
    network, report, maps, theirs = compared(
        kit, tmp_path / "util_9.pt", "2.x", rng, optimizer_state_dict={}, idx_log_iter=9
    )
    for name, output in head_maps(network, maps).items():
        torch.testing.assert_close(output.double(), theirs[name], rtol=1e-5, atol=1e-5)
    assert not any("no configuration" in note for note in report.notes)
