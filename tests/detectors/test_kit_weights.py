"""Checkpoints of K-Radar's kit: each layer's output is the plain dense computation's; every odd name and shape is told.

On generated checkpoints: no real one was at hand.
"""

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from kit_rtnh import KitRTNH, published_boxes, wide_boxes
from small import batch_of

from farfield.detectors.importing import examine_checkpoint
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


@pytest.mark.parametrize("classes", [1, 3])
def test_other_numbers_of_classes_of_doppler_and_of_layers(tmp_path, classes, rng):
    kit = KitRTNH("wide", layers=20, classes=classes, input=5, **SMALL)
    path, anchors = saved(tmp_path / "x.pt", kit.saved()), {}
    if classes == 3:
        with pytest.raises(ConfigError, match=r"3 classes apart.*name their anchors in --settings"):
            import_rtnh(path)
        box = {"size_m": (1.0, 1.0, 1.0), "z_m": 0.0}
        anchors = {"anchors": dict.fromkeys(("vehicle", "bicycle", "pedestrian"), box)}
    network, report = import_rtnh(path, settings={**settings_of(20), **anchors})
    ours, maps = layers_of(network, points := points_of("wide", 20, rng, 5))
    theirs = kit.outputs(points, LOW, (20, 8, 8))
    torch.testing.assert_close(ours["convtrans2d2"].double(), theirs["convtrans2d2"], rtol=1e-5, atol=1e-5)
    assert head_maps(network, maps)["conv_cls"].shape == theirs["conv_cls"].shape
    assert network.config.columns[-1] == "doppler_m_s"
    assert any("classes 3: 1 or 2 there" in note for note in report.notes) == (classes == 3)
    assert import_rtnh(path, settings=anchors)[0].config.grid.half_width_m == 6.4  # 20 layers: the narrow region


def test_boxes_are_those_of_the_published_head(tmp_path, rng):
    kit = KitRTNH("published", layers=20, **SMALL)
    network, _, maps, theirs = compared(kit, tmp_path / "x.pt", "2.x", rng)
    every = np.arange(8 * 8 * 2)
    rows = network.head._decoded(maps.codes[0].reshape(-1, 8).double().numpy(), every)
    expected = published_boxes(theirs["conv_reg"], LOW).transpose(1, 0, 2, 3).reshape(-1, 7)
    expected[:, 3:6] = np.maximum(expected[:, 3:6], 0.1)  # sizes that the kit gives below 0 are ours' least
    np.testing.assert_allclose(rows[:, :6], expected[:, :6], atol=1e-4)
    np.testing.assert_allclose(np.cos(rows[:, 6] - expected[:, 6]), 1.0, atol=1e-6)


def test_boxes_are_those_of_the_wide_head(tmp_path, rng):
    kit = KitRTNH("wide", layers=24, **SMALL)
    network, _, maps, theirs = compared(kit, tmp_path / "x.pt", "2.x", rng)
    every, expected = np.arange(8 * 8 * 4), wide_boxes(theirs, LOW, (3.2, 1.6))
    directions = (maps.directions[0, :, 1] > maps.directions[0, :, 0]).long().numpy()
    rows = network.head.anchors.decode(maps.codes[0].double().numpy(), directions, every)
    expected = expected.transpose(1, 0, 2, 3).reshape(-1, 7)
    usual = (np.abs(np.log(expected[:, 3:6] / network.head.anchors.rows(every)[:, 3:6])) < 2).all(1)
    assert usual.mean() > 0.5
    np.testing.assert_allclose(rows[usual, :6], expected[usual, :6], rtol=1e-4, atol=1e-4)
    np.testing.assert_allclose(np.cos(rows[:, 6] - expected[:, 6]), 1.0, atol=1e-5)


def test_every_odd_name_and_shape_is_told_at_once(tmp_path):
    state = KitRTNH("wide", layers=24, **SMALL).saved()
    del state["backbone.subm1a.bias"], state["backbone.bnt2.running_var"]
    state["head.conv_extra.weight"] = torch.zeros(3)
    state["backbone.toBEV2.weight"] = torch.zeros(10, 7, 1, 1, 10)
    state["backbone.spconv1.weight"] = state["backbone.spconv1.weight"].permute(1, 2, 3, 0, 4)
    state["pre_processor.simplified_pointnet.weight"] = torch.zeros(5)
    with pytest.raises(ConfigError) as caught:
        import_rtnh(saved(tmp_path / "x.pt", state))
    message = str(caught.value)
    assert "missing: backbone.subm1a.bias" in message
    assert "missing: backbone.bnt2.running_var" in message
    assert "unknown: head.conv_extra.weight" in message
    assert "backbone.toBEV2.weight: expected shape (10, 6, 1, 1, 10) (spconv 2.x), got (10, 7, 1, 1, 10)" in message
    assert "backbone.spconv1.weight: expected shape (8, 3, 3, 3, 6) (spconv 2.x), got (3, 3, 3, 8, 6)" in message
    assert "pre_processor.simplified_pointnet.weight: expected shape (5, 4)" in message
    assert len(message.splitlines()) == 7


def test_unknown_names_can_be_left_out_and_numbers_that_no_training_leaves_cannot(tmp_path):
    state = KitRTNH("published", layers=20, **SMALL).saved()
    state["roi_head.weight"] = torch.zeros(2)
    path = saved(tmp_path / "x.pt", state)
    with pytest.raises(ConfigError, match=r"unknown: roi_head\.weight\nUnknown keys can be left out"):
        import_rtnh(path)
    assert import_rtnh(path, allow_unknown=True)[1].unknown == ("roi_head.weight",)
    state["backbone.bn0.running_var"][2] = -1.0
    with pytest.raises(ConfigError, match=r"backbone\.bn0\.running_var: expected numbers as a training leaves them"):
        import_rtnh(saved(path, state), allow_unknown=True)


def test_another_height_needs_its_grid(tmp_path):
    path = saved(tmp_path / "x.pt", KitRTNH("published", layers=16, **SMALL).saved())
    with pytest.raises(ConfigError, match=r"16 cells tall, expected 20 \(narrow\) or 24 \(wide\)"):
        import_rtnh(path)
    assert import_rtnh(path, settings=settings_of(16))[0].config.grid.z_max_m == 4.4


def test_other_networks_are_refused_by_their_first_names(tmp_path):
    with pytest.raises(ConfigError, match=r"expected keys of RTNH as K-Radar's kit names them, got conv1\.weight"):
        import_rtnh(saved(tmp_path / "x.pt", {"conv1.weight": torch.zeros(3)}))


def test_what_it_reads_and_what_no_checkpoint_says_is_told(tmp_path):
    network, report = import_rtnh(saved(tmp_path / "x.pt", KitRTNH("published", layers=20, **SMALL).saved()))
    assert report.data["options"] == {
        "reference": "radar", "radar_rate": 0.1, "radar_region": "narrow", "radar_over": "region"
    }  # fmt: skip
    assert network.config.first_cell == "before it"
    shown = report.text()
    assert "K-Radar's kit checkpoint as rtnh: 96 keys used, 15 ignored" in shown
    assert "taken as configs/cfg_RTNH.yml, with vehicle; kernels as spconv 2.x stores them" in shown
    assert "no configuration of the kit has widths (6, 8, 10): (64, 128, 256) there" in shown
    assert "no real checkpoint of the kit was seen" in shown
    _, wide = import_rtnh(saved(tmp_path / "y.pt", KitRTNH("wide", layers=24, **SMALL).saved()))
    assert "taken as configs/cfg_RTNH_wide.yml, with vehicle, large_vehicle" in wide.text()


@pytest.mark.parametrize("form", ["published", "wide"])
def test_imported_weights_travel_as_ours_and_are_described(tmp_path, form, rng):
    kit = KitRTNH(form, layers=LAYERS[form], **SMALL)
    path = saved(tmp_path / "x.pt", kit.saved())
    network, _ = import_rtnh(path, settings=settings_of(kit.layers))
    save_weights(tmp_path / "w.safetensors", network.state_dict(), config=network.config, provenance={})
    again, _ = load_weights(tmp_path / "w.safetensors")
    points = batch_of(torch.from_numpy(points_of(form, kit.layers, rng)))
    with torch.no_grad():
        for one, other in zip(network(points), again(points), strict=True):
            torch.testing.assert_close(one, other)
    theirs, ours = examine_checkpoint(path), examine_checkpoint(tmp_path / "w.safetensors")
    assert (theirs.what, theirs.tensors, theirs.fault) == ("RTNH of K-Radar's kit", len(kit.state), "")
    assert "leave out 15 and miss none" in theirs.fate
    assert ours.what.startswith("rtnh of Farfield, for vehicle")
    assert "nothing to import" in ours.fate
