"""KITTI raw's tracklets, edited in their places: what did not change keeps its bytes.

An object has one class and one size in all its frames, which follow each other without a gap. So a class or a size
that changes in one frame changes in all; a box taken out of the middle parts the object in two, of which the second
stands at the end of the file; and a new box of an object joins it where its frame comes just before or after.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import ClassVar
from xml.sax.saxutils import escape

from farfield.datasets.labels.formats import BoxLabel, Numbers, Value
from farfield.datasets.labels.line_labels import kept_numbers
from farfield.errors import ConfigError, DatasetError
from farfield.files.cuboids import Cuboid
from farfield.files.tracklets import CONVENTIONS, Convention, parse_tracklets
from farfield.files.xml_tree import Edit, Span, edited, parse_spans
from farfield.frame import Key

_EMPTY = b"""<?xml version="1.0" encoding="UTF-8" standalone="yes" ?>
<!DOCTYPE boost_serialization>
<boost_serialization signature="serialization::archive" version="9">
<tracklets class_id="0" tracking_level="0" version="0">
\t<count>0</count>
\t<item_version>1</item_version>
</tracklets>
</boost_serialization>
"""
_TAGS = (
    b'<item class_id="1" tracking_level="0" version="1">',
    b'<poses class_id="2" tracking_level="0" version="0">',
    b'<item class_id="3" tracking_level="0" version="2">',
)
"""The first object, the first list of poses and the first pose name their kinds, as boost's archives do."""
_SEEN = {"occlusion": (0.0, 1.0, 2.0, -1.0), "truncation": (0.0, 1.0, 2.0, 3.0, 99.0)}
_PLACES = ("tx", "ty", "tz", "rz")


@dataclass(eq=False)
class _TrackletObject:
    """One object: what the file has of it, and what is wanted.

    Args:
        span: Its element; None for a new one.
        label: Its class.
        size_m: Length, width, height.
        convention: What its numbers in the file stand for.
        poses: By frame, the bytes of each; None where they are still to be written from ``boxes``.
        boxes: By frame, what is new.
    """

    span: Span | None
    label: str
    size_m: tuple[float, float, float]
    convention: Convention
    poses: dict[int, Span | None] = field(default_factory=dict)
    boxes: dict[int, BoxLabel] = field(default_factory=dict)
    named: set[str] = field(default_factory=set)
    sized: set[tuple[float, float, float]] = field(default_factory=set)


@dataclass(frozen=True)
class TrackletLabels:
    """``tracklet_labels.xml``, one file a drive; a track is the object's place in the file.

    Args:
        places: File and number of each frame.
        conventions: What the numbers of each file stand for; KITTI's own where it is not named.
    """

    name: ClassVar[str] = "kitti-tracklets"
    attributes: ClassVar[Mapping[str, tuple[Value, ...]]] = _SEEN
    places: Mapping[Key, tuple[Path, int]]
    conventions: Mapping[Path, Convention] = field(default_factory=dict)

    def path(self, key: Key) -> Path:
        """The file of a frame's drive.

        Raises:
            DatasetError: If there is no such frame.
        """
        if key not in self.places:
            raise DatasetError(f"expected a frame of this data set, got {'/'.join(key)}")
        return self.places[key][0]

    def parse(self, data: bytes, path: Path, keys: Sequence[Key]) -> Mapping[Key, tuple[BoxLabel, ...]]:
        """Labels of the frames, objects in the file's order."""
        cuboids: dict[str, list[Cuboid]] = {}
        for cuboid in parse_tracklets(data, path, self._convention(path)):
            cuboids.setdefault(cuboid.frame, []).append(cuboid)
        return {key: _labels(cuboids.get(str(self.places[key][1]), ())) for key in keys}

    def render(self, data: bytes | None, path: Path, labels: Mapping[Key, Sequence[BoxLabel]]) -> bytes:
        """The file with other labels in some frames."""
        before = _EMPTY if data is None else data
        old_labels = self.parse(before, path, list(labels))
        if all(tuple(new_labels) == old_labels[key] for key, new_labels in labels.items()):
            return before
        numbered = {self.places[key][1]: (old_labels[key], new_labels) for key, new_labels in labels.items()}
        return _rendered(before, path, numbered, self._convention(path))

    def _convention(self, path: Path) -> Convention:
        return self.conventions.get(path, CONVENTIONS["kitti"])


def _labels(cuboids: Sequence[Cuboid]) -> tuple[BoxLabel, ...]:
    return tuple(
        BoxLabel(id=str(number), label=cuboid.label, box=cuboid.box, track=cuboid.track, attributes=cuboid.attributes)
        for number, cuboid in enumerate(cuboids)
    )


def _rendered(
    data: bytes,
    path: Path,
    frames: Mapping[int, tuple[Sequence[BoxLabel], Sequence[BoxLabel]]],
    convention: Convention,
) -> bytes:
    root = parse_spans(data, path)
    (tracklets,) = root.all("tracklets")
    objects = [_object(data, span, convention) for span in tracklets.all("item")]
    touched: set[int] = set()
    edits: list[Edit] = []
    added: list[tuple[int, BoxLabel]] = []
    for frame, (old, new_labels) in sorted(frames.items()):
        left = {label.id: label for label in new_labels}
        for label in old:
            number = int(label.track)
            new = left.pop(label.id, None)
            if new is None or new.track != label.track:
                del objects[number].poses[frame]
                touched.add(number)
                added += [] if new is None else [(frame, new)]
            else:
                edits += _changes(objects[number], frame, label, new)
        added += [(frame, label) for label in left.values()]
    touched |= _joined(objects, added, convention)
    for tracklet in objects:
        edits += _of_all(tracklet, path)
    return _assembled(data, tracklets, objects, touched, edits)


def _object(data: bytes, span: Span, convention: Convention) -> _TrackletObject:
    texts = _texts(data, span)
    poses = [pose for group in span.all("poses") for pose in group.all("item")]
    first = int(float(texts["first_frame"]))
    length, width, height = (float(texts[name]) for name in convention.sizes)
    numbered: dict[int, Span | None] = {first + step: pose for step, pose in enumerate(poses)}
    return _TrackletObject(span, texts["objectType"], (length, width, height), convention, numbered)


def _texts(data: bytes, span: Span) -> dict[str, str]:
    leaves = reversed([child for child in span.children if not child.children])
    return {child.name: data[child.inner : child.close].decode().strip() for child in leaves}


def _changes(tracklet: _TrackletObject, frame: int, old: BoxLabel, new: BoxLabel) -> Iterator[Edit]:
    """Edits of one pose; class and size are noted for the whole object."""
    box, pose = kept_numbers(old.box, new.box), tracklet.poses[frame]
    assert pose is not None
    if new.label != old.label:
        tracklet.named.add(new.label)
    if box[3:6] != old.box[3:6]:
        tracklet.sized.add((box[3], box[4], box[5]))
    places = (_place(numbers, tracklet.convention) for numbers in (old.box, box))
    for name, before, after in zip(_PLACES, *places, strict=True):
        if before != after:
            yield _text(pose, name, repr(after))
    for name, value in _seen(new).items():
        if value != old.attributes.get(name, value):
            yield _text(pose, name, f"{value:g}")


def _place(box: Numbers, convention: Convention) -> tuple[float, float, float, float]:
    return box[0], box[1], box[2] - box[5] / 2 if convention.bottom else box[2], box[6]


def _seen(label: BoxLabel) -> dict[str, float]:
    values = {name: float(label.attributes[name]) for name in _SEEN if name in label.attributes}
    for name, value in values.items():
        if value not in _SEEN[name]:
            raise ConfigError(f"a {label.label}: expected {name} of {_SEEN[name]}, got {value:g}")
    return values


def _text(span: Span, name: str, text: str) -> Edit:
    child = span.one(name)
    if child is None:
        return (span.close, span.close, f"<{name}>{text}</{name}>".encode())
    return (child.inner, child.close, text.encode())


def _joined(objects: list[_TrackletObject], added: Sequence[tuple[int, BoxLabel]], convention: Convention) -> set[int]:
    """Put new boxes into the objects that they continue, or into new ones; which objects have others now."""
    touched: set[int] = set()
    begun: dict[tuple[str, str], int] = {}
    for frame, label in added:
        size = (label.box[3], label.box[4], label.box[5])
        exists = label.track.isdecimal() and int(label.track) < len(objects) and objects[int(label.track)].span
        number = int(label.track) if exists else begun.get((label.track, label.label), -1)
        if number < 0 or not label.track or frame in objects[number].poses or objects[number].label != label.label:
            number = begun[label.track, label.label] = len(objects)
            objects.append(_TrackletObject(None, label.label, size, convention))
        tracklet = objects[number]
        tracklet.poses[frame], tracklet.boxes[frame] = None, label
        if size != tracklet.size_m:
            tracklet.sized.add(size)
        touched.add(number)
    return touched


def _of_all(tracklet: _TrackletObject, path: Path) -> Iterator[Edit]:
    """Edits of what an object has once: class and size."""
    for what, values in (("class", tracklet.named), ("size", tracklet.sized)):
        if len(values) > 1:
            fix = "Lock its size (Ctrl+L), or give one of the boxes another track."
            raise ConfigError(f"{path}: an object has one {what} in all frames, got {sorted(values)}. {fix}")
    if tracklet.span is not None and tracklet.named:
        (named,) = tracklet.named
        yield _text(tracklet.span, "objectType", escape(named))
    if tracklet.sized:
        before, (after,) = tracklet.size_m, tracklet.sized
        tracklet.size_m = after
        for name, old, new in zip(tracklet.convention.sizes, before, after, strict=True):
            if tracklet.span is not None and old != new:
                yield _text(tracklet.span, name, repr(float(new)))


def _assembled(
    data: bytes, tracklets: Span, objects: list[_TrackletObject], touched: set[int], edits: list[Edit]
) -> bytes:
    """The file: objects whose frames stayed by their edits, the others anew around the bytes of their poses."""
    more: list[bytes] = []
    remaining = 0
    all_edits = list(edits)
    for number, tracklet in enumerate(objects):
        runs = list(_runs(tracklet.poses)) if number in touched else []
        if number in touched and tracklet.span is not None:
            inside = [item for item in edits if tracklet.span.start <= item[0] < tracklet.span.end]
            all_edits = [item for item in all_edits if item not in inside]
            begin = _blanks_before(data, tracklet.span.start)
            new = _with_poses(data, tracklet, runs[0], inside) if runs else b""
            all_edits.append((tracklet.span.start if runs else begin, tracklet.span.end, new))
        remaining += tracklet.span is not None and (number not in touched or bool(runs))
        later = runs[1:] if tracklet.span is not None else runs
        more += [_new_object(data, replace(tracklet, span=None), run, edits) for run in later]
    total = tracklets.one("count")
    if (total is not None and more) or (total is not None and remaining != len(tracklets.all("item"))):
        all_edits.append((total.inner, total.close, b"%d" % (remaining + len(more))))
    end = _blanks_before(data, tracklets.close)
    all_edits.append((end, end, b"".join(b"\n\t" + item for item in more)))
    return _named(edited(data, all_edits), data)


def _runs(poses: Mapping[int, Span | None]) -> Iterator[list[int]]:
    run: list[int] = []
    for frame in sorted(poses):
        if run and frame != run[-1] + 1:
            yield run
            run = []
        run.append(frame)
    if run:
        yield run


def _blanks_before(data: bytes, at: int) -> int:
    return len(data[:at].rstrip())


def _with_poses(data: bytes, tracklet: _TrackletObject, run: Sequence[int], edits: Sequence[Edit]) -> bytes:
    """An object's bytes with the poses of a run."""
    span = tracklet.span
    assert span is not None
    group = span.one("poses")
    assert group is not None
    items = group.all("item")
    begin = _blanks_before(data, items[0].start) if items else _blanks_before(data, group.close)
    changes = [edit for edit in edits if not group.start <= edit[0] < group.end]
    poses = b"".join(b"\n\t\t\t" + _pose(data, tracklet, frame, edits) for frame in run)
    changes.append((begin, items[-1].end if items else begin, poses))
    count = group.one("count")
    if count is not None:
        changes.append((count.inner, count.close, b"%d" % len(run)))
    if run[0] != int(float(_texts(data, span)["first_frame"])):
        changes.append(_text(span, "first_frame", str(run[0])))
    return edited(data, changes, span.start, span.end)


def _pose(data: bytes, tracklet: _TrackletObject, frame: int, edits: Sequence[Edit]) -> bytes:
    span = tracklet.poses[frame]
    if span is not None:
        return edited(data, edits, span.start, span.end)
    label = tracklet.boxes[frame]
    x, y, z, yaw = map(repr, map(float, _place(label.box, tracklet.convention)))
    attributes = {"occlusion": -1.0, "truncation": 99.0} | _seen(label)
    values = {"tx": x, "ty": y, "tz": z, "rx": "0", "ry": "0", "rz": yaw, "state": "2"}
    values |= {
        "occlusion": f"{attributes['occlusion']:g}",
        "occlusion_kf": "1",
        "truncation": f"{attributes['truncation']:g}",
    }
    values |= {"amt_occlusion": "0", "amt_occlusion_kf": "1", "amt_border_l": "0", "amt_border_r": "0"}
    lines = "".join(f"\n\t\t\t\t<{name}>{text}</{name}>" for name, text in {**values, "amt_border_kf": "1"}.items())
    return f"<item>{lines}\n\t\t\t</item>".encode()


def _new_object(data: bytes, tracklet: _TrackletObject, run: Sequence[int], edits: Sequence[Edit]) -> bytes:
    sizes = dict(zip(tracklet.convention.sizes, map(repr, map(float, tracklet.size_m)), strict=True))
    label = escape(next(iter(tracklet.named), tracklet.label))
    head = {"objectType": label, **{name: sizes[name] for name in "hwl"}, "first_frame": str(run[0])}
    lines = "".join(f"\n\t\t<{name}>{text}</{name}>" for name, text in head.items())
    poses = b"".join(b"\n\t\t\t" + _pose(data, tracklet, frame, edits) for frame in run)
    counts = f"\n\t\t<poses>\n\t\t\t<count>{len(run)}</count>\n\t\t\t<item_version>2</item_version>"
    return f"<item>{lines}{counts}".encode() + poses + b"\n\t\t</poses>\n\t\t<finished>1</finished>\n\t</item>"


def _named(data: bytes, before: bytes) -> bytes:
    """The file in which the first object, list of poses and pose name their kinds, where they did before."""
    (tracklets,) = parse_spans(data, "").all("tracklets")
    objects = tracklets.all("item")
    groups = [group for item in objects for group in item.all("poses")]
    poses = [pose for group in groups for pose in group.all("item")]
    edits: list[Edit] = []
    for tag, spans in zip(_TAGS, (objects, groups, poses), strict=True):
        if tag not in before and before != _EMPTY:
            continue
        plain = b"<%s>" % tag[1:].split()[0]
        for position, span in enumerate(spans):
            new_tag = tag if position == 0 else plain
            present = data[span.start : span.inner]
            if present in (tag, plain) and present != new_tag:
                edits.append((span.start, span.inner, new_tag))
    return edited(data, edits)
