"""Maps on frames: made by name, replayed, told apart by the fingerprint, pickled."""

import json
import pickle
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from drive import frame as kradar_frame
from pydantic import BaseModel

from farfield.datasets import DATASETS, Format, open_dataset
from farfield.datasets.base import Dataset
from farfield.datasets.kradar import KRadar, KRadarWriter
from farfield.datasets.kradar.radar_cloud import RadarView
from farfield.datasets.maps import MAPS, Coordinates, Move, Sweeps, TransformedCloud, described, make, none_before
from farfield.datasets.recipes import plain, recipe_of_experiment, replay
from farfield.detectors.info import DetectorInfo
from farfield.errors import ConfigError
from farfield.evaluation import as_trained
from farfield.files.clouds import write_bin
from farfield.frame import Frame
from farfield.geometry.poses import invert, pose_from_yaw
from tests.datasets.test_sweeps import Drive

HALF_TURN = Move.turned(180)


@pytest.fixture
def folder(tmp_path: Path, rng: np.random.Generator) -> Path:
    for stem in "abc":
        write_bin(tmp_path / f"{stem}.bin", rng.uniform(0, 1, (5, 4)).astype(np.float32))
    return tmp_path


@pytest.fixture(scope="module")
def kradar(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("kradar")
    writer = KRadarWriter(root)
    for number in (1, 2, 3):
        writer.write(kradar_frame(number))
    writer.finish()
    return root


def names(data: Dataset) -> list[str]:
    return [one["name"] for one in data.recipe["maps"]]


@pytest.mark.parametrize(
    "function",
    [HALF_TURN, Sweeps(3), RadarView(rate=0.01, region="narrow"), Coordinates("radar")],
    ids=lambda f: f.name,
)
def test_a_map_is_its_name_and_settings(function):
    tree = json.loads(json.dumps(described(function)))
    again = make(tree["name"], tree["settings"])
    assert type(again) is type(function)
    assert described(again) == described(function) == described(pickle.loads(pickle.dumps(function)))


def test_unknown_maps_and_settings_are_errors():
    with pytest.raises(
        ConfigError,
        match="edited, labels_at, move, posed, radar_view, separate_labels, sweeps, where, whole_bodies; got 'mirror'",
    ):
        make("mirror", {})
    with pytest.raises(ConfigError, match=r"map 'sweeps': number: no such key.*settings count"):
        make("sweeps", {"count": 2, "number": 2})
    with pytest.raises(ConfigError, match="count"):
        make("sweeps", {})
    with pytest.raises(ConfigError, match="rigid motion"):
        make("move", {"target_T_frame": (2 * np.eye(4)).tolist()})
    with pytest.raises(ConfigError, match="radar_rate"):
        make("radar_view", {"rate": 0.4})


def test_a_map_of_another_package_by_decorator():
    class NothingSettings(BaseModel, extra="forbid"):
        pass

    @dataclass(frozen=True)
    class Unannotated:
        name = "unannotated"
        Settings = NothingSettings

        def settings(self) -> dict[str, object]:
            return {}

        def __call__(self, frame: Frame, earlier: Callable[[int], Frame | None]) -> Frame:
            assert earlier(1) is None or earlier(1).key < frame.key
            return Frame(sequence=frame.sequence, frame_id=frame.frame_id, clouds=frame.clouds)

    MAPS.register("unannotated")(Unannotated)
    data = Drive().select([3, 6]).mapped(make("unannotated", {}))
    assert data[0].boxes is None
    assert data.annotation(0) is None
    assert replay(Drive(), data.recipe)[3].boxes is None
    assert data.drives()[0].world_T_frame is None


def test_earlier_frames_are_those_of_the_parent_seen_likewise():
    """The k-th frame before in its drive, through selections and through the maps beneath."""
    data = Drive().turned(90).select([3, 6])
    assert [None if one is None else one.frame_id for one in (data.before(0, k) for k in range(5))] == [
        *("3", "2", "1", "0"),
        None,
    ]
    assert data.before(1, 3) is None  # frame 6 is the third of its drive
    np.testing.assert_allclose(data.before(0, 1).boxes.centre_m, Drive().turned(90)[2].boxes.centre_m)


def test_fingerprints_tell_views_apart_and_stay_without_them(kradar, folder):
    plain_data = open_dataset(kradar)
    usual = {"reference": "os2-64", "radar_rate": 0.1, "radar_over": "all", "rotate_deg": 0}
    assert open_dataset(kradar, **usual).fingerprint() == plain_data.fingerprint()
    seen = [
        plain_data,
        open_dataset(kradar, radar_rate=0.01),
        open_dataset(kradar, radar_rate=0.05),
        open_dataset(kradar, reference="radar"),
        plain_data.mapped(Sweeps(2)),
        plain_data.turned(90),
    ]
    assert len({data.fingerprint() for data in seen}) == len(seen)
    assert open_dataset(folder).fingerprint() == open_dataset(folder).select(range(3)).fingerprint()


def test_the_fingerprint_of_plain_frames_is_that_of_names_and_sizes(folder):
    """As provenance of earlier versions has it."""
    import hashlib

    digest, name = hashlib.sha256(), folder.resolve().name
    for stem in "abc":
        digest.update(f"{name}\0{stem}".encode())
        digest.update(f"\0{stem}.bin\0{(folder / f'{stem}.bin').stat().st_size}\n".encode())
    assert open_dataset(folder, bin_columns=4).fingerprint(options=False) == digest.hexdigest()


def test_recipes_are_json_and_replayed(kradar):
    options = {
        "reference": "radar",
        "radar_rate": 0.05,
        "radar_region": "narrow",
        "rotate_deg": 180,
        "roots": (kradar,),
    }
    data = open_dataset(kradar, **options).mapped(Sweeps(2))
    recipe = json.loads(json.dumps(data.recipe))
    assert (recipe["format"], recipe["options"]) == ("kradar", {"roots": [str(kradar)]})
    assert [one["name"] for one in recipe["maps"]] == ["coordinates", "radar_view", "move", "sweeps"]
    again = replay(open_dataset(kradar), recipe)
    assert again.recipe["maps"] == recipe["maps"]
    assert again.fingerprint() == data.fingerprint()
    for one, other in zip(data, again, strict=True):
        for name in one.clouds:
            np.testing.assert_array_equal(one.clouds[name].points_m, other.clouds[name].points_m)


def test_a_recipe_takes_its_place_beneath_what_the_data_have(kradar):
    recipe = open_dataset(kradar, reference="radar", radar_rate=0.01).mapped(Sweeps(3)).recipe
    plain_data = open_dataset(kradar)
    assert names(replay(plain_data.turned(90), recipe)) == ["coordinates", "radar_view", "sweeps", "move"]
    stacked = replay(plain_data.mapped(Sweeps(2)).select([2, 0]), recipe)
    assert stacked.recipe["maps"][-1] == {"name": "sweeps", "settings": {"count": 2}}  # those that are stacked stay
    assert (len(stacked), stacked.keys[0]) == (2, plain_data.keys[2])
    other = replay(open_dataset(kradar, radar_rate=0.05, radar_region="narrow"), recipe)
    assert other.recipe["maps"][1]["settings"]["rate"] == 0.01  # as the detector learnt
    assert replay(stacked, recipe) is stacked
    assert replay(plain_data, {}) is plain_data


def test_what_a_format_does_not_offer_is_passed_over(kradar):
    drive = Drive()
    recipe = open_dataset(kradar, reference="radar", radar_rate=0.01, rotate_deg=180).recipe
    assert names(replay(drive, recipe)) == ["move"]


def trained_on(**provenance: object) -> DetectorInfo:
    """A detector by what is known of its training."""
    return DetectorInfo(provenance=provenance)


@pytest.mark.parametrize("with_recipe", [True, False])
def test_all_that_was_trained_is_replayed(kradar, with_recipe):
    """Provenance of earlier versions holds options and sweeps; of this one the recipe."""
    options = {"reference": "radar", "radar_rate": 0.01, "radar_region": "narrow", "rotate_deg": 180, "labels": "v1.0"}
    trained = open_dataset(kradar, **options).mapped(Sweeps(2))
    known = {"streams": {"labelled": {"recipe": trained.recipe}}} if with_recipe else {}
    detector = trained_on(experiment={"data": {"path": "x", "options": options, "sweeps": 2}}, **known)
    seen = as_trained(open_dataset(kradar), detector)
    assert seen.recipe["maps"] == trained.recipe["maps"]
    np.testing.assert_array_equal(seen[1].cloud("radar").points_m, trained[1].cloud("radar").points_m)
    turned = as_trained(Drive(), trained_on(experiment={"data": {"options": {"rotate_deg": 180}}}))
    np.testing.assert_allclose(turned[1].boxes.centre_m, Drive()[1].boxes.centre_m * [-1, -1, 1], atol=1e-9)
    assert as_trained(turned, trained_on(experiment={"data": {"options": {"rotate_deg": 180}}})) is turned
    assert recipe_of_experiment({}) == {"format": None, "options": {}, "maps": []}


def test_options_unknown_to_the_reader_are_named(folder, kradar):
    with pytest.raises(
        ConfigError, match=r"folder reader does not know the option 'reference'; it knows mapping, bin_columns"
    ):
        open_dataset(folder, reference="radar")
    with pytest.raises(ConfigError, match=r"'radar_rat'.*calibration.*radar_rate.*rotate_deg"):
        open_dataset(kradar, radar_rat=0.1)
    with pytest.raises(ConfigError, match="os2-64 or radar"):
        open_dataset(kradar, reference="lidar")


def test_a_readers_own_type_error_surfaces(folder, monkeypatch):
    """Its text may be that of a wrong option."""

    class Faulty:
        view_options = ()

        def __init__(self, root, *, size=1):
            raise TypeError("helper() got an unexpected keyword argument 'size'")

    faulty = Format(name="folder", looked_for="", recognises=lambda root: True, reader=Faulty)
    monkeypatch.setitem(DATASETS._loaded, "folder", faulty)
    with pytest.raises(TypeError, match="helper"):
        open_dataset(folder, size=2)


def test_a_radar_view_works_on_any_frame_with_products(kradar):
    """Moments of a tesseract as well as published points; coordinates and what stands in them do not matter."""
    opened = open_dataset(kradar, radar_region="cube")[0]
    bare = open_dataset(kradar)[0]
    seen = RadarView(region="cube")(bare, none_before)
    np.testing.assert_array_equal(seen.clouds["radar"].points_m, opened.clouds["radar"].points_m)
    stacked = open_dataset(kradar).mapped(Sweeps(2)).mapped(RadarView(region="cube"))
    with pytest.raises(ConfigError, match="several sweeps"):
        stacked[1]


def test_coordinates_do_not_move_there_and_back(kradar):
    """The radar's cloud in the radar's coordinates is as its file has it, to the bit."""
    seen = open_dataset(kradar, radar_region="cube", reference="radar")[0]
    sparse = seen.radar["sparse"]
    inside = np.isin(sparse[:, 0].astype(np.float32), seen.clouds["radar"].points_m[:, 0])
    np.testing.assert_array_equal(sparse[inside, :3].astype(np.float32), seen.clouds["radar"].points_m)
    back = open_dataset(kradar, reference="radar").mapped(Coordinates("os2-64"))[0]
    np.testing.assert_allclose(back.boxes.centre_m, open_dataset(kradar)[0].boxes.centre_m, atol=1e-9)
    assert Coordinates("radar")(seen, none_before) is seen
    with pytest.raises(ConfigError, match="'radar' stands"):
        Drive().mapped(Coordinates("radar"))[0]


def test_placed_clouds_move_once(rng):
    cloud = Drive()[0].cloud("gaussian")
    pose = pose_from_yaw(0.3, (2.0, -1.0, 0.5))
    placed = TransformedCloud(Drive()[0].clouds.get, pose)  # type: ignore[arg-type]
    assert np.allclose(placed.moved(invert(pose)).frame_T_sensor, np.eye(4))
    here = TransformedCloud(lambda: cloud, pose).moved(invert(pose))
    assert here() is cloud


def test_the_unwrapped_reader_and_its_indices(kradar):
    reader = KRadar(kradar)
    seen = reader.select([2, 1]).turned(10).select([1]).mapped(Sweeps(2))
    assert seen.unwrapped is reader
    assert seen.origins == (1,)
    assert names(seen) == ["move", "sweeps"]
    assert seen.split("train", by="benchmark").unwrapped is reader
    with pytest.raises(ConfigError, match="has no parts 'train'"):
        Drive().split("train", by="benchmark")


def test_mapped_data_sets_pickle():
    data = Drive().turned(30).mapped(Sweeps(2)).select([1, 2])
    again = pickle.loads(pickle.dumps(data))
    np.testing.assert_array_equal(again[1].cloud("gaussian").points_m, data[1].cloud("gaussian").points_m)


def test_options_that_json_cannot_hold_are_errors(tmp_path):
    assert plain({"a": (tmp_path, 1)}) == {"a": [str(tmp_path), 1]}
    with pytest.raises(ConfigError, match="ndarray"):
        plain(np.zeros(2))
