"""Features with a place: rows, and frames parted again."""

import pytest

torch = pytest.importorskip("torch")

from farfield.detectors.features import FeatureMap, PointFeatures
from farfield.detectors.sparse import SparseTensor


def dense(frames: int = 3) -> FeatureMap:
    values = torch.arange(frames * 2 * 4 * 5, dtype=torch.float32).view(frames, 2, 4, 5)
    return FeatureMap(values=values, cell_m=0.5, origin_m=(0.0, -1.25), aux={"score": torch.arange(frames)})


def sparse() -> FeatureMap:
    cells = torch.tensor([[0, 0, 1, 2], [0, 0, 3, 4], [1, 0, 0, 0], [2, 0, 2, 2]])
    values = SparseTensor.from_indices(torch.arange(8.0).view(4, 2), cells, (1, 4, 5), 3)
    return FeatureMap(values=values, cell_m=2.0, origin_m=(1.0, -5.0), aux={"height": values.replace(torch.ones(4, 1))})


def points() -> PointFeatures:
    xyz = torch.arange(18.0).view(6, 3)
    return PointFeatures(values=xyz * 2, xyz=xyz, lengths=(3, 0, 3), aux={"rows": torch.arange(6)})


def test_rows_of_a_dense_map_stand_at_the_centres_of_their_cells():
    features = dense()
    rows = features.rows()
    assert rows.values.shape == (60, 2)
    for number in (0, 7, 23, 59):
        frame = int(rows.frame[number])
        ix, iy = int(rows.place_m[number, 0] / 0.5), int((rows.place_m[number, 1] + 1.25) / 0.5)
        assert torch.equal(rows.values[number], features.values[frame, :, ix, iy])
        assert rows.place_m[number].tolist() == [(ix + 0.5) * 0.5, (iy + 0.5) * 0.5 - 1.25]


def test_rows_of_sparse_features_are_the_occupied_cells():
    rows = sparse().rows()
    assert rows.frame.tolist() == [0, 0, 1, 2]
    assert rows.place_m.tolist() == [[4.0, 0.0], [8.0, 4.0], [2.0, -4.0], [6.0, 0.0]]
    assert rows.values.tolist() == [[0, 1], [2, 3], [4, 5], [6, 7]]


def test_rows_of_points_have_their_frame():
    rows = points().rows()
    assert rows.frame.tolist() == [0, 0, 0, 2, 2, 2]
    assert rows.place_m[1].tolist() == [3, 4]


@pytest.mark.parametrize("make", [dense, sparse, points])
def test_few_rows_are_drawn_by_the_generator_or_spread_evenly(make):
    features = make()
    every = features.rows()
    seeded = [features.rows(3, torch.Generator().manual_seed(seed)) for seed in (1, 1, 2)]
    assert all(torch.equal(a, b) for a, b in zip(seeded[0], seeded[1], strict=True))
    for rows in (*seeded, features.rows(limit=3)):
        assert len(rows.values) == 3
        numbers = [
            next(i for i, v in enumerate(every.values) if torch.equal(v, value) and every.frame[i] == frame)
            for value, frame in zip(rows.values, rows.frame, strict=True)
        ]
        assert numbers == sorted(set(numbers))
        assert torch.equal(every.place_m[numbers], rows.place_m)
    assert len(features.rows(limit=1000).values) == len(every.values)


@pytest.mark.parametrize("make", [dense, sparse, points])
def test_frames_are_parted_with_all_that_is_theirs(make):
    features = make()
    one, rest = features.split(1)
    assert (len(one), len(rest)) == (1, 2)
    together, parts = features.rows(), (one.rows(), rest.rows())
    assert torch.equal(torch.cat([part.values for part in parts]), together.values)
    assert torch.equal(torch.cat([part.place_m for part in parts]), together.place_m)
    assert torch.equal(torch.cat([parts[0].frame, parts[1].frame + 1]), together.frame)
    assert set(one.aux) == set(rest.aux) == set(features.aux)
    for bad in (0, 3):
        with pytest.raises(ValueError, match="1 to 2 of 3 frames"):
            features.split(bad)


def test_what_belongs_to_cells_and_points_is_parted_too():
    one, rest = sparse().split(1)
    assert one.aux["height"].keys.tolist() == one.values.keys.tolist()
    assert rest.aux["height"].keys.tolist() == rest.values.keys.tolist() == [0, 20 + 2 * 5 + 2]
    assert [part.aux["rows"].tolist() for part in points().split(2)] == [[0, 1, 2], [3, 4, 5]]
    assert [part.aux["score"].tolist() for part in dense().split(2)] == [[0, 1], [2]]


def test_gradients_flow_through_rows_and_split():
    values = torch.ones(2, 3, 4, 4, requires_grad=True)
    one, rest = FeatureMap(values=values, cell_m=1.0, origin_m=(0.0, 0.0)).split(1)
    (one.rows(limit=5).values.sum() + rest.rows().values.sum()).backward()
    assert values.grad.sum() == 5 * 3 + 16 * 3


def test_the_other_form_of_features_is_refused():
    with pytest.raises(TypeError, match="got sparse ones"):
        _ = sparse().dense
    with pytest.raises(TypeError, match="got dense ones"):
        _ = dense().sparse
