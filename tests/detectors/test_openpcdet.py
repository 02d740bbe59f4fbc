import numpy as np
import pytest

torch = pytest.importorskip("torch")

import their_forward as their
from small import batch_of, losses_of, targets_of

from farfield.detectors.openpcdet import import_openpcdet
from farfield.detectors.runtime import Detector
from farfield.detectors.weights import load_weights, save_weights
from farfield.errors import ConfigError, FileFormatError
from farfield.frame import Cloud
from farfield.geometry.boxes import Boxes
from farfield.geometry.iou import pairwise_iou

PILLARS = {"grid": {"range_m": 19.2, "half_width_m": 6.4, "z_min_m": -3.0, "z_max_m": 1.0, "cell_m": 0.4}}
VOXELS = {
    "grid": {
        "range_m": 12.8,
        "half_width_m": 4.8,
        "z_min_m": -3.0,
        "z_max_m": 1.0,
        "cell_m": (0.2, 0.2, 0.1),
        "extra_layers": 1,
    }
}
SETTINGS = {"pointpillars": PILLARS, "second": VOXELS}
LAYOUTS = ["1.x", "2.x", "2.x native"]


def saved(path, state, **rest):
    torch.save({"model_state": state, "epoch": 80, "it": 74240, "version": "pcdet+0.6.0", **rest}, path)
    return path


@pytest.fixture
def points(rng):
    """Points all over the grid, some of it crowded, in no order; x, y, z, intensity, lag."""
    wide = rng.uniform([0, -6.4, -3, 0], [19.2, 6.4, 1, 1], (1500, 4))
    crowded = np.concatenate(
        [rng.normal([*place, -1, 0.5], [0.15, 0.15, 0.3, 0.1], (120, 4)) for place in ((5, 1), (9, -3))]
    )
    rows = rng.permutation(np.concatenate([wide, crowded])).astype(np.float32)
    return np.column_stack([rows, np.zeros(len(rows), np.float32)])


def their_outputs(kind, state, points):
    """Their class, box and direction outputs, and boxes, over ny, nx, anchor."""
    with torch.no_grad():
        if kind == "pointpillars":
            size, shape, limits = np.array([0.4, 0.4, 4.0]), (1, 32, 48), (0, -6.4, 19.2, 6.4)
            image = their.pillar_image(state, points[:, :4].astype(float), np.array([0, -6.4, -3]), size, shape)
            outputs = their.heads(state, image, (2, 2, 2))
        else:
            size, shape, limits = np.array([0.2, 0.2, 0.1]), (41, 48, 64), (0, -4.8, 12.8, 4.8)
            image = their.second_image(state, points[:, :4].astype(float), np.array([0, -4.8, -3]), size, shape)
            outputs = their.heads(state, image, (1, 2))
    return *outputs, their.boxes(*outputs[1:], limits)


@pytest.fixture(params=["pointpillars", *(f"second {layout}" for layout in LAYOUTS)])
def imported(request, tmp_path):
    """Kind, their weights in the layout of conv3d, the imported network and its report."""
    kind, _, layout = request.param.partition(" ")
    state = their.pillar_weights() if kind == "pointpillars" else their.second_weights()
    path = saved(tmp_path / "theirs.pth", their.with_layout(state, layout) if layout else state)
    return kind, state, *import_openpcdet(path, settings=SETTINGS[kind])


def test_outputs_and_boxes_are_theirs(imported, points):
    kind, state, network, _ = imported
    logits, codes, directions, boxes = their_outputs(kind, state, points)
    with torch.no_grad():
        ours = network(batch_of(torch.from_numpy(points)))
    ny, nx = logits.shape[:2]
    assert logits.std() > 0.05
    assert (network.head.anchors.nx, network.head.anchors.ny) == (nx, ny)
    for theirs, found in zip((logits, codes, directions), ours, strict=True):
        found = found[0].view(nx, ny, 6, -1).transpose(0, 1).double().numpy()
        np.testing.assert_allclose(found, theirs, atol=1e-4, rtol=1e-4)
    every = np.arange(len(network.head.anchors))
    backwards = (ours.directions[0, :, 1] > ours.directions[0, :, 0]).long().numpy()
    rows = network.head.anchors.decode(ours.codes[0].double().numpy(), backwards, every)
    rows = rows.reshape(nx, ny, 6, 7).transpose(1, 0, 2, 3)
    sure = np.abs(directions[..., 0] - directions[..., 1]) > 1e-3
    assert sure.mean() > 0.9
    np.testing.assert_allclose(rows[..., :6], boxes[..., :6], atol=1e-4, rtol=1e-4)
    np.testing.assert_allclose(np.cos(rows[..., 6] - boxes[..., 6])[sure], 1.0, atol=1e-6)


def test_predicted_boxes_are_theirs_after_suppression(imported, points):
    kind, state, network, _ = imported
    logits, _, _, rows = their_outputs(kind, state, points)
    score = 1 / (1 + np.exp(-logits.reshape(-1, 3)))
    rows, best = rows.reshape(-1, 7), score.max(1)
    names = np.array(["vehicle", "pedestrian", "bicycle"])[score.argmax(1)]
    order = [i for i in np.argsort(-best)[:200] if best[i] >= 0.1]
    truth = Boxes(centre_m=rows[order, :3], size_m=rows[order, 3:6], yaw_rad=rows[order, 6], label=names[order])
    overlap, kept = pairwise_iou(truth, truth, kind="bev"), []
    for i in range(len(order)):
        if all(overlap[i, j] <= 0.01 for j in kept):
            kept.append(i)
    found = network.predict(batch_of(torch.from_numpy(points)))[0]
    shown = min(8, len(kept))
    assert shown > 3
    np.testing.assert_allclose(found.score[:shown], best[order][kept[:shown]], atol=1e-4)
    np.testing.assert_allclose(found.centre_m[:shown], truth.centre_m[kept[:shown]], atol=1e-3)
    assert found.label[:shown].tolist() == truth.label[kept[:shown]].tolist()


def test_every_key_is_accounted_for(imported):
    kind, state, network, report = imported
    assert report.kind == kind
    assert set(report.mapped) | set(report.ignored) == set(state)
    assert not report.unknown
    assert set(report.mapped.values()) == {k for k in network.state_dict() if "num_batches" not in k}
    assert all("num_batches_tracked" in key or key == "global_step" for key in report.ignored)
    assert "ignored, a count of batches" in report.text()
    assert "dense_head.conv_box.bias -> head.bias" in report.text(every_key=True)


def test_imported_weights_travel_as_ours_and_run_folded(imported, points, tmp_path):
    _, _, network, _ = imported
    save_weights(tmp_path / "w.safetensors", network.state_dict(), config=network.config, provenance={})
    loaded, _ = load_weights(tmp_path / "w.safetensors")
    cloud = Cloud(points[:, :3], points[:, 3])
    one, other = (Detector(n, precision="fp32", device="cpu")(cloud) for n in (loaded, network))
    np.testing.assert_array_equal(one.centre_m, other.centre_m)
    with torch.no_grad():
        plain = network.predict(batch_of(torch.from_numpy(points)))[0]
    np.testing.assert_allclose(one.score[:20], plain.score[:20], atol=1e-4)


def test_imported_networks_train_on(imported, points):
    _, _, network, _ = imported
    network.train()
    boxes = Boxes(
        centre_m=np.array([[5.0, 1.0, -1.0], [9.0, -3.0, -0.8]]),
        size_m=np.array([[3.9, 1.6, 1.5], [0.8, 0.6, 1.7]]),
        yaw_rad=np.array([0.2, 1.4]),
        label=["vehicle", "pedestrian"],
    )
    assert len(targets_of(network, boxes, torch.from_numpy(points)).positive) >= 2
    losses = losses_of(network, [torch.from_numpy(points)], [boxes])
    sum(losses.values()).backward()
    assert all(torch.isfinite(loss) for loss in losses.values())
    assert [name for name, p in network.named_parameters() if p.grad is None or not p.grad.abs().sum() > 0] == []
    assert {m.momentum for m in network.modules() if hasattr(m, "momentum")} == {0.01}
    assert {m.eps for m in network.modules() if hasattr(m, "eps")} == {1e-3}


def test_unknown_keys_are_an_error_unless_allowed(tmp_path):
    state = their.pillar_weights()
    state["dense_head.conv_iou.weight"] = torch.zeros(6, 30, 1, 1)
    path = saved(tmp_path / "x.pth", state)
    with pytest.raises(ConfigError, match=r"unknown: dense_head\.conv_iou\.weight"):
        import_openpcdet(path, settings=PILLARS)
    _, report = import_openpcdet(path, settings=PILLARS, allow_unknown=True)
    assert report.unknown == ("dense_head.conv_iou.weight",)
    assert "UNKNOWN, left out as allowed: dense_head.conv_iou.weight" in report.text()


@pytest.mark.parametrize(
    ("key", "message"),
    [
        ("backbone_2d.blocks.1.4.weight", r"missing: backbone_2d\.blocks\.1\.4\.weight"),
        ("dense_head.conv_dir_cls.bias", r"missing: dense_head\.conv_dir_cls\.bias"),
        ("vfe.pfn_layers.0.norm.running_var", r"missing: vfe"),
        ("backbone_2d.deblocks.0.0.weight", r"key backbone_2d\.deblocks\.0\.0\.weight"),
        ("backbone_2d.blocks.0.1.weight", r"key backbone_2d\.blocks\.0\.1\.weight"),
    ],
)
def test_missing_keys_are_an_error(tmp_path, key, message):
    state = their.pillar_weights()
    del state[key]
    with pytest.raises(ConfigError, match=message):
        import_openpcdet(saved(tmp_path / "x.pth", state), settings=PILLARS)


@pytest.mark.parametrize(
    ("key", "shape", "message"),
    [
        ("vfe.pfn_layers.0.linear.weight", (8, 11), r"expected shape \(8, 10\).*got \(8, 11\)"),
        ("dense_head.conv_cls.weight", (6, 30, 1, 1), "has each of its classes one of the anchors"),
        ("dense_head.conv_cls.weight", (7, 30, 1, 1), "has each of its classes one of the anchors"),
        ("dense_head.conv_cls.weight", (18, 31, 1, 1), "expected shape"),
        ("backbone_2d.blocks.0.1.weight", (8, 9, 3, 3), "expected shape"),
        ("backbone_2d.blocks.0.1.weight", (8, 9), "expected 4 axes"),
        ("backbone_2d.deblocks.1.1.bias", (), "expected shape"),
    ],
)
def test_other_shapes_are_an_error_that_names_both(tmp_path, key, shape, message):
    state = their.pillar_weights()
    state[key] = torch.zeros(shape)
    with pytest.raises(ConfigError, match=message):
        import_openpcdet(saved(tmp_path / "x.pth", state), settings=PILLARS)


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("backbone_2d.blocks.0.1.weight", float("nan")),
        ("dense_head.conv_box.bias", float("inf")),
        ("backbone_2d.blocks.0.2.running_var", -1.0),
    ],
)
def test_numbers_that_no_training_leaves_are_an_error_that_names_them(tmp_path, key, value):
    state = their.pillar_weights()
    state[key].view(-1)[0] = value
    with pytest.raises(ConfigError, match=rf"{key}: expected numbers as a training leaves them, got {value:g}"):
        import_openpcdet(saved(tmp_path / "x.pth", state), settings=PILLARS)


def test_other_inputs_of_second_are_an_error(tmp_path):
    state = their.second_weights()
    state["backbone_3d.conv_input.0.weight"] = torch.zeros(3, 3, 3, 5, 6)
    with pytest.raises(ConfigError, match="x, y, z and intensity"):
        import_openpcdet(saved(tmp_path / "x.pth", state), settings=VOXELS)
    path = saved(tmp_path / "x.pth", their.with_layout(their.second_weights(), "2.x"))
    with pytest.raises(ConfigError, match=r"at least 25 layers"):
        import_openpcdet(path, settings={"grid": {**VOXELS["grid"], "cell_m": (0.2, 0.2, 0.4)}})


class Evil:
    def __reduce__(self):
        return print, ("executed",)


@pytest.mark.parametrize("content", [{"model_state": {"a": Evil()}}, {"model_state": {"a": 3}}, {"model_state": {}}, 7])
def test_files_that_are_no_checkpoint_are_refused_and_nothing_is_executed(tmp_path, capsys, content):
    torch.save(content, tmp_path / "x.pth")
    with pytest.raises(FileFormatError, match=r"x\.pth"):
        import_openpcdet(tmp_path / "x.pth")
    assert "executed" not in capsys.readouterr().out


@pytest.mark.parametrize("content", [b"", b"\x80\x04pickle", b"PK\x03\x04" + b"\x00" * 40])
def test_damaged_files_are_refused(tmp_path, content):
    (tmp_path / "x.pth").write_bytes(content)
    with pytest.raises(FileFormatError, match="checkpoint"):
        import_openpcdet(tmp_path / "x.pth")


def test_other_networks_are_not_recognised(tmp_path):
    with pytest.raises(ConfigError, match="PointPillars or SECOND"):
        import_openpcdet(saved(tmp_path / "x.pth", {"conv1.weight": torch.zeros(3)}))


def test_kitti_settings_give_the_published_maps(tmp_path):
    state = their.Weights(0)
    state.draw("vfe.pfn_layers.0.linear.weight", 64, 10)
    state.norm("vfe.pfn_layers.0.norm", 64)
    state.bird_eye(64, (64, 128, 256), (3, 5, 5), (1, 2, 4), 128, spread=0.1)
    network, _ = import_openpcdet(saved(tmp_path / "x.pth", dict(state)))
    assert (network.head.anchors.nx, network.head.anchors.ny, network.head.in_channels) == (216, 248, 384)
    assert network.config.depths == (3, 5, 5)
    assert network.config.class_names == ("vehicle", "pedestrian", "bicycle")
