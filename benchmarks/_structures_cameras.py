"""Structural edits of pictures, depth maps and calibrations: modes, sizes, lenses, poses, forms of other programs."""

import io
import json
import struct
import zlib
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from _structures import Case, Family, Oracle, Reading, apart
from PIL import Image

import farfield as ff
from farfield.files import depth_png, images, kitti

# PNG, written chunk by chunk (ISO/IEC 15948).


def png_bytes(pixels: np.ndarray, *, colour: int, bits: int = 8, texts: Mapping[str, str] | None = None) -> bytes:
    """Pixels (height, width, channels) of one colour type, without a filter."""
    height, width = pixels.shape[:2]
    lines = pixels.astype(">u2" if bits == 16 else "u1").reshape(height, -1)
    raw = b"".join(b"\0" + line.tobytes() for line in lines)
    chunks = [(b"IHDR", struct.pack(">IIBBBBB", width, height, bits, colour, 0, 0, 0))]
    chunks += [(b"tEXt", f"{name}\0{text}".encode("latin-1")) for name, text in (texts or {}).items()]
    chunks += [(b"IDAT", zlib.compress(raw)), (b"IEND", b"")]
    packed = [
        struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data)) for kind, data in chunks
    ]
    return b"\x89PNG\r\n\x1a\n" + b"".join(packed)


def picture(random: np.random.Generator, folder: Path) -> Case:
    """A PNG of any colour type; RGB has to come out."""
    height, width = (int(side) for side in random.integers(1, 30, 2))
    rgb = random.integers(0, 256, (height, width, 3)).astype("u1")
    grey, alpha = rgb[:, :, :1], random.integers(0, 256, (height, width, 1)).astype("u1")
    high = random.integers(0, 65536, (height, width, 1)).astype("u2")
    repeated = np.repeat(grey, 3, axis=2)
    plain = png_bytes(rgb, colour=2)
    options: tuple[tuple[str, bytes, np.ndarray | None], ...] = (
        ("RGB", plain, rgb),
        ("grey", png_bytes(grey, colour=0), repeated),
        ("grey of 16 bits", png_bytes(high, colour=0, bits=16), np.repeat((high >> 8).astype("u1"), 3, axis=2)),
        ("RGB with transparency", png_bytes(np.concatenate([rgb, alpha], axis=2), colour=6), rgb),
        ("grey with transparency", png_bytes(np.concatenate([grey, alpha], axis=2), colour=4), repeated),
        ("RGB of 16 bits", png_bytes(rgb.astype("u2") * 257, colour=2, bits=16), rgb),
        ("RGB with a text", png_bytes(rgb, colour=2, texts={"Comment": "made here"}), rgb),
        ("cut", plain[: len(plain) // 2], None),
        ("a checksum wrong", plain[:29] + bytes([plain[29] ^ 1]) + plain[30:], None),
        ("a width of 0", plain[:16] + bytes(4) + plain[20:], None),
        ("a BMP", _saved(rgb, "BMP"), None),
        ("a TIFF", _saved(rgb, "TIFF"), None),
        ("empty", b"", None),
        ("an SVG", b"<svg xmlns='http://www.w3.org/2000/svg'/>", None),
    )
    words, data, expected = options[random.integers(len(options))]
    path = folder / str(random.choice(["a.png", "a.PNG", "a.jpg"]))
    path.write_bytes(data)
    difference = partial(_array_differs, np.zeros(0) if expected is None else expected)
    oracle: Oracle = "refused" if expected is None else "same"
    return Case((words, path.suffix), oracle, lambda: Reading(images.read_image(path)), difference)


def _saved(rgb: np.ndarray, kind: str) -> bytes:
    file = io.BytesIO()
    Image.fromarray(rgb).save(file, format=kind)
    return file.getvalue()


def _array_differs(expected: np.ndarray, actual: Any) -> str:
    return apart("array", actual, expected)


def jpeg(random: np.random.Generator, folder: Path) -> Case:
    """A JPEG of even blocks: grey, CMYK, turned by EXIF; pixels as they are stored."""
    blocks = random.integers(30, 220, (2, 3, 3)).astype("u1")
    rgb = np.repeat(np.repeat(blocks, 16, axis=0), 16, axis=1)
    kind = str(random.choice(["RGB", "grey", "CMYK", "progressive", "EXIF", "cut", "PNG inside"]))
    file, exif = io.BytesIO(), Image.Exif()
    exif[0x0112] = 6
    shown = Image.fromarray(rgb)
    shown = shown.convert("L") if kind == "grey" else shown.convert("CMYK") if kind == "CMYK" else shown
    more: dict[str, Any] = {"exif": exif} if kind == "EXIF" else {}
    shown.save(
        file,
        format="PNG" if kind == "PNG inside" else "JPEG",
        **more,
        **({} if kind == "PNG inside" else {"quality": 95, "subsampling": 0, "progressive": kind == "progressive"}),
    )
    data = file.getvalue()
    path = folder / "a.jpg"
    path.write_bytes(data[: len(data) // 2] if kind == "cut" else data)
    expected = np.asarray(shown.convert("RGB"))
    oracle: Oracle = "refused" if kind == "cut" else "same"
    return Case(
        (kind,),
        oracle,
        lambda: Reading(images.read_image(path)),
        lambda actual: apart("pixels", actual, expected, tolerance=6),
    )


def depth(random: np.random.Generator, folder: Path) -> Case:
    """KITTI's depth maps: 256 steps a metre, 0 for none; another scale is named by a text."""
    height, width = (int(side) for side in random.integers(1, 40, 2))
    steps = random.integers(0, 65536, (height, width, 1)).astype("u2")
    scale = int(random.choice([256, 256, 128, 100, 1, 65535]))
    texts = {} if scale == 256 and random.random() < 0.5 else {"depth_scale": str(scale)}
    expected = np.where(steps[:, :, 0] == 0, np.nan, steps[:, :, 0] / scale)
    good = png_bytes(steps, colour=0, bits=16, texts=texts)
    options: tuple[tuple[str, bytes, Oracle], ...] = (
        *((f"scale {scale}", good, "same"),) * 6,
        ("8 bits", png_bytes(steps >> 8, colour=0), "refused"),
        ("RGB", png_bytes(np.repeat(steps >> 8, 3, axis=2), colour=2), "refused"),
        ("cut", good[: len(good) // 2], "refused"),
        ("cut behind its pixels", good[: len(good) - 12], "either"),
        *(
            (f"scale {text!r}", png_bytes(steps, colour=0, bits=16, texts={"depth_scale": text}), "refused")
            for text in ("0", "-1", "65536", "1e3", "256.0", "nan", "")
        ),
        ("a JPEG", _saved(np.repeat((steps >> 8).astype("u1"), 3, axis=2), "JPEG"), "refused"),
    )
    words, data, oracle = options[random.integers(len(options))]
    (folder / "a.png").write_bytes(data)
    difference = partial(_array_differs, expected)
    return Case((words,), oracle, lambda: Reading(depth_png.read_depth(folder / "a.png").depth_m), difference)


# KITTI's calibrations.


def calib(random: np.random.Generator, folder: Path) -> Case:
    """``NAME: numbers`` a line; a frame's camera has to come out."""
    matrices = {name: np.round(random.normal(0, 300, 12), 6) for name in ("P0", "P1", "P2", "P3")}
    matrices |= {"R0_rect": np.round(random.normal(size=9), 6), "Tr_velo_to_cam": np.round(random.normal(size=12), 6)}
    lines = {name: f"{name}: " + " ".join(f"{value:.12e}" for value in values) for name, values in matrices.items()}
    name = [*lines][random.integers(6)]
    kinds: dict[str, Oracle] = {
        "as it is": "same",
        "no colon": "same",
        "an empty line behind": "same",
        "CR LF": "same",
        "in another order": "same",
        "a name without numbers": "same",
        "a number less": "refused",
        "a number more": "refused",
        "a word": "refused",
        "NaN": "refused",
        "inf": "refused",
        "twice": "refused",
        "decimal commas": "refused",
        "empty": "refused",
        "1_0": "refused",
        "tabs": "same",
        "blanks before": "same",
    }
    kind = str(random.choice([*kinds]))
    text = lines[name]
    changed = {
        "a number less": text.rsplit(" ", 1)[0],
        "a number more": f"{text} 1.0",
        "a word": f"{text.rsplit(' ', 1)[0]} none",
        "NaN": f"{text.rsplit(' ', 1)[0]} nan",
        "inf": f"{text.rsplit(' ', 1)[0]} inf",
        "decimal commas": text.replace(".", ","),
        "1_0": f"{text.rsplit(' ', 1)[0]} 1_0",
        "tabs": text.replace(" ", "\t"),
        "blanks before": f"  {text}",
        "no colon": text.replace(":", ""),
    }.get(kind, text)
    rows = [changed if key == name else line for key, line in lines.items()]
    rows += {"twice": [text], "a name without numbers": ["Tr_imu_to_velo:"], "an empty line behind": [""]}.get(kind, [])
    rows = [] if kind == "empty" else rows[::-1] if kind == "in another order" else rows
    (folder / "000000.txt").write_bytes(("\r\n" if kind == "CR LF" else "\n").join([*rows, ""]).encode())
    expected = {key: values.reshape(3, -1) for key, values in matrices.items()}
    return Case(
        (f"{name}: {kind}" if kind != "as it is" else kind,),
        kinds[kind],
        lambda: Reading(kitti.read_calib(folder / "000000.txt")),
        partial(_matrices_differ, expected),
    )


def _matrices_differ(expected: Mapping[str, np.ndarray], actual: Mapping[str, np.ndarray]) -> str:
    if {*actual} != {*expected}:
        return f"names {[*actual]}"
    return next((text for name in expected if (text := apart(name, actual[name], expected[name]))), "")


# calibration.yaml of an own folder: ours, ROS', OpenCV's, Kalibr's.


def _numbers(values: np.ndarray) -> list[Any]:
    return np.asarray(values).tolist()


def ours(matrix: np.ndarray, lens: np.ndarray, motion: np.ndarray, size: Sequence[int]) -> dict[str, Any]:
    """Our own form."""
    return {
        "matrix": _numbers(matrix),
        "distortion": _numbers(lens),
        "camera_T_lidar": _numbers(motion),
        "width": size[0],
        "height": size[1],
    }


def ros(matrix: np.ndarray, lens: np.ndarray, motion: np.ndarray, size: Sequence[int]) -> dict[str, Any]:
    """ROS' camera_info with the pose added."""
    return {
        "image_width": size[0],
        "image_height": size[1],
        "camera_name": "camera",
        "camera_matrix": {"rows": 3, "cols": 3, "data": _numbers(matrix.reshape(-1))},
        "distortion_model": "plumb_bob",
        "distortion_coefficients": {"rows": 1, "cols": 5, "data": _numbers(lens)},
        "camera_T_lidar": _numbers(motion),
    }


def opencv(matrix: np.ndarray, lens: np.ndarray, motion: np.ndarray, size: Sequence[int]) -> dict[str, Any]:
    """OpenCV's FileStorage, its matrices as groups."""
    return {
        "image_width": size[0],
        "image_height": size[1],
        "camera_matrix": {"rows": 3, "cols": 3, "dt": "d", "data": _numbers(matrix.reshape(-1))},
        "distortion_coefficients": {"rows": 1, "cols": 5, "dt": "d", "data": _numbers(lens)},
        "camera_T_lidar": _numbers(motion),
    }


def kalibr(matrix: np.ndarray, lens: np.ndarray, motion: np.ndarray, size: Sequence[int]) -> dict[str, Any]:
    """Kalibr's camchain."""
    intrinsics = [matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2]]
    node = {
        "camera_model": "pinhole",
        "intrinsics": _numbers(np.array(intrinsics)),
        "distortion_model": "radtan",
        "distortion_coeffs": _numbers(lens[:4]),
        "resolution": [*size],
        "T_cam_lidar": _numbers(motion),
    }
    return {"camera": node}


FORMS: dict[str, Callable[..., dict[str, Any]]] = {"ours": ours, "ros": ros, "opencv": opencv, "kalibr": kalibr}


def calibration(random: np.random.Generator, folder: Path) -> Case:
    """A folder with a cloud, a picture and a calibration: its camera comes out, or is said to be unusable."""
    form = str(random.choice([*FORMS]))
    focal, size = random.uniform(300, 2000), (int(random.integers(200, 2000)), int(random.integers(200, 1200)))
    matrix = np.round(np.array([[focal, 0, size[0] / 2], [0, focal * 1.01, size[1] / 2], [0, 0, 1]]), 4)
    lens = np.round(random.normal(0, 0.05, 5), 5) if random.random() < 0.7 else np.zeros(5)
    if form == "kalibr":
        lens[4] = 0
    angle = random.uniform(-0.2, 0.2)
    turn = np.array([[np.sin(angle), -np.cos(angle), 0], [0, 0, -1], [np.cos(angle), np.sin(angle), 0]])
    motion = np.vstack([np.column_stack([turn, random.uniform(-2, 2, 3)]), [0, 0, 0, 1]])
    content = FORMS[form](matrix, lens, motion, size)
    node = content["camera"] if form == "kalibr" else content
    pose_key = "T_cam_lidar" if form == "kalibr" else "camera_T_lidar"
    words, oracle = str(random.choice(["as it is", "as it is", "as JSON", *CALIBRATION_EDITS])), "same"
    if words in CALIBRATION_EDITS:
        oracle = "said"
        CALIBRATION_EDITS[words](node, pose_key)
    told = "intrinsics" if words == "no pose" and form != "ours" else "no camera is calibrated"
    text = json.dumps(content, indent=1) if words == "as JSON" or random.random() < 0.3 else _yaml(content)
    if form == "opencv" and random.random() < 0.5:
        text = "%YAML:1.0\n---\n" + _yaml(content).replace("camera_matrix:", "camera_matrix: !!opencv-matrix").replace(
            "distortion_coefficients:", "distortion_coefficients: !!opencv-matrix"
        )
    (folder / f"calibration.{'json' if words == 'as JSON' else 'yaml'}").write_text(text)
    (folder / "0001.xyz").write_text("1 2 3 0.5\n4 5 6 0.7\n")
    (folder / "0001.png").write_bytes(png_bytes(np.zeros((4, 6, 3), "u1"), colour=2))
    expected = None if oracle == "said" else (matrix, lens, motion, size)
    return Case((form, words), oracle, partial(_read_camera, folder), partial(_camera_differs, expected), told)


def _yaml(content: Mapping[str, Any]) -> str:
    import yaml

    return yaml.safe_dump(content, sort_keys=False, default_flow_style=None)


def _drop(key: str, node: dict[str, Any], pose_key: str) -> None:
    node.pop(pose_key if key == "pose" else key, None)


def _mirrored(node: dict[str, Any], pose_key: str) -> None:
    node[pose_key] = [[-value for value in node[pose_key][0]], *node[pose_key][1:]]


def _stretched(node: dict[str, Any], pose_key: str) -> None:
    node[pose_key] = [[1.2 * value for value in node[pose_key][0]], *node[pose_key][1:]]


def _short(node: dict[str, Any], pose_key: str) -> None:
    node[pose_key] = node[pose_key][:3]


def _transposed(node: dict[str, Any], pose_key: str) -> None:
    node[pose_key] = [list(row) for row in zip(*node[pose_key], strict=True)]


def _not_a_number(node: dict[str, Any], pose_key: str) -> None:
    node[pose_key][0][3] = float("nan")


def _text_number(node: dict[str, Any], pose_key: str) -> None:
    node[pose_key][1][3] = "two"


def _matrix_of(node: dict[str, Any]) -> tuple[dict[str, Any], str]:
    if "intrinsics" in node:
        return node, "intrinsics"
    return (node["camera_matrix"], "data") if "camera_matrix" in node else (node, "matrix")


def _negative_focal(node: dict[str, Any], pose_key: str) -> None:
    del pose_key
    holder, key = _matrix_of(node)
    values = holder[key]
    if isinstance(values[0], list):
        values[0][0] = -values[0][0]
    else:
        values[0] = -values[0]


def _short_matrix(node: dict[str, Any], pose_key: str) -> None:
    del pose_key
    holder, key = _matrix_of(node)
    holder[key] = holder[key][:-1]


def _fisheye(node: dict[str, Any], pose_key: str) -> None:
    del pose_key
    node["distortion_model"] = "equidistant"  # an unknown key of our own form


def _many_terms(node: dict[str, Any], pose_key: str) -> None:
    del pose_key
    holder = node.get("distortion_coefficients", node)
    key = next(name for name in ("data", "distortion_coeffs", "distortion") if name in holder)
    holder[key] = [0.1, 0.01, 0.001, 0.001, 0.02, 0.3, 0.2, 0.1]


CALIBRATION_EDITS: dict[str, Callable[[dict[str, Any], str], None]] = {
    "no pose": partial(_drop, "pose"),
    "a mirrored pose": _mirrored,
    "a transposed pose": _transposed,
    "a stretched pose": _stretched,
    "a pose of three rows": _short,
    "a pose with NaN": _not_a_number,
    "a pose with a word": _text_number,
    "a negative focal length": _negative_focal,
    "a number of the matrix less": _short_matrix,
    "a fisheye": _fisheye,
    "eight terms of distortion": _many_terms,
}


def _read_camera(folder: Path) -> Reading:
    data = ff.open_dataset(folder)
    frame = data[0]
    assert len(frame.cloud()) == 2
    assert frame.images["camera"].shape == (4, 6, 3)
    return Reading(frame.cameras.get("camera"), " ".join(map(str, data.notes)))


def _camera_differs(expected: Any, camera: Any) -> str:
    if expected is None:
        return "" if camera is None else "a camera that is calibrated"
    if camera is None:
        return "no camera"
    matrix, lens, motion, size = expected
    return (
        apart("matrix", camera.matrix, matrix)
        or apart("distortion", camera.distortion, lens)
        or apart("camera_T_lidar", camera.camera_T_lidar, motion)
        or apart("size", (camera.width_px, camera.height_px), size)
    )


FAMILIES = (
    Family("png", picture, 2),
    Family("jpeg", jpeg, 1),
    Family("depth png", depth, 2),
    Family("kitti calib", calib, 2),
    Family("calibration.yaml", calibration, 5),
)
