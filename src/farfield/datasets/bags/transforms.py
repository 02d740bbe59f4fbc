"""The tree of coordinates of a bag: fixed edges of ``/tf_static``, moving ones of ``/tf`` or of an odometry."""

from collections.abc import Iterable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Float, Int64

from farfield.errors import FileFormatError
from farfield.files.bags import Bag, guarded
from farfield.geometry.poses import pose, rotation_from_quaternion

Pose = Float[np.ndarray, "4 4"]
KINDS = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")  # the latter of ROS 1's first releases
ODOMETRY = "nav_msgs/msg/Odometry"
STATIC = "tf_static"
_LONGEST_CHAIN = 100


@dataclass(eq=False)
class Edge:
    """Where a frame stands in its parent.

    Args:
        parent: The parent.
        times_ns: When, for a moving one, in order, shape (n,).
        parent_T_child: Poses, shape (n, 4, 4); a fixed one has a single pose and no times.
    """

    parent: str
    times_ns: Int64[np.ndarray, " n"]
    parent_T_child: Float[np.ndarray, "m 4 4"]

    def at(self, time_ns: int, tolerance_ns: int) -> Pose | None:
        """The pose at a moment, the turn along the shortest arc and the place along a line; None outside its time."""
        times = self.times_ns
        if not len(times):
            return self.parent_T_child[0]
        if not times[0] - tolerance_ns <= time_ns <= times[-1] + tolerance_ns:
            return None
        after = int(np.clip(np.searchsorted(times, time_ns), 1, len(times) - 1)) if len(times) > 1 else 0
        if not after:
            return self.parent_T_child[0]
        share = float(np.clip((time_ns - int(times[after - 1])) / int(times[after] - times[after - 1]), 0, 1))
        return _between(self.parent_T_child[after - 1], self.parent_T_child[after], share)


def _between(first: Pose, second: Pose, share: float) -> Pose:
    from scipy.spatial.transform import Rotation

    turn = Rotation.from_matrix(first[:3, :3].T @ second[:3, :3]).as_rotvec()
    translation = (1 - share) * first[:3, 3] + share * second[:3, 3]
    return pose(first[:3, :3] @ Rotation.from_rotvec(share * turn).as_matrix(), translation)


@dataclass(eq=False)
class Transforms:
    """Transforms of a bag, read at the first use.

    One that is no rigid motion is passed over, and only what needs the frame above which no other stands is refused.

    Args:
        bag: The bag.
    """

    bag: Bag
    _faults: dict[str, FileFormatError] = field(default_factory=dict)

    @cached_property
    def edges(self) -> dict[str, Edge]:
        """The edge above each frame."""
        names = [topic.name for topic in self.bag.topics if topic.kind in KINDS]
        fixed: dict[str, tuple[str, Pose]] = {}
        moving: dict[str, dict[int, tuple[str, Pose]]] = {}
        for topic, _, raw in self.bag.messages(names) if names else ():
            for child, parent, time_ns, matrix in self._listed(self.bag.decode(topic, raw)):
                if topic.name.endswith(STATIC):
                    fixed[child] = (parent, matrix)
                else:
                    moving.setdefault(child, {})[time_ns] = (parent, matrix)
        for child, stamped in self._odometry().items():
            if child not in fixed and child not in moving:
                moving[child] = stamped
        nothing = np.zeros(0, dtype=np.int64)
        edges = {child: Edge(parent, nothing, matrix[None]) for child, (parent, matrix) in fixed.items()}
        for child, stamped in moving.items():
            times = sorted(stamped)
            parent = stamped[times[-1]][0]
            edge_times = [time for time in times if stamped[time][0] == parent]
            edges[child] = Edge(
                parent, np.array(edge_times, dtype=np.int64), np.array([stamped[t][1] for t in edge_times])
            )
        return edges

    def _odometry(self) -> dict[str, dict[int, tuple[str, Pose]]]:
        """Parent and pose by time of each frame that one topic of odometry moves; of several none is chosen.

        A topic without a frame or with an orientation that is none, as some wheels' odometry is, moves nothing.
        """
        by_topic: dict[str, dict[int, tuple[str, Pose]]] = {}
        frame_of: dict[str, str] = {}
        names = [topic.name for topic in self.bag.topics if topic.kind == ODOMETRY]
        for topic, _, raw in self.bag.messages(names) if names else ():
            message = self.bag.decode(topic, raw)
            with guarded(self.bag.path, "an odometry"):
                part = message.header, message.child_frame_id, message.pose.pose.position, message.pose.pose.orientation
            try:
                child, parent, time_ns, matrix = self._edge(*part)
            except FileFormatError:
                child, parent, time_ns, matrix = "", "", 0, np.eye(4)
            frame_of[topic.name] = child if frame_of.get(topic.name, child) == child else ""
            by_topic.setdefault(topic.name, {})[time_ns] = (parent, matrix)
        moved = list(frame_of.values())
        return {child: by_topic[name] for name, child in frame_of.items() if child and moved.count(child) == 1}

    def _listed(self, message: Any) -> list[tuple[str, str, int, Pose]]:
        with guarded(self.bag.path, "transforms"):  # a damaged definition leaves fields out
            parts = [(entry.header, entry.child_frame_id, entry.transform) for entry in message.transforms]
            return [edge for part in parts if (edge := self._sound(*part)) is not None]

    def _sound(self, header: Any, frame: Any, motion: Any) -> tuple[str, str, int, Pose] | None:
        """One transform; None, and the fault is kept, where it is no rigid motion."""
        try:
            return self._edge(header, frame, motion.translation, motion.rotation)
        except FileFormatError as error:
            self._faults.setdefault(str(frame).strip("/"), error)
            return None

    @property
    def notes(self) -> tuple[str, ...]:
        """A sentence on each frame of which transforms were passed over."""
        edges = self.edges
        return tuple(
            f"{error} It is passed over"
            + ("" if child in edges else f": where {child} stands, and what hangs on it, is not known")
            for child, error in self._faults.items()
        )

    def _edge(self, header: Any, frame: Any, translation: Any, turn: Any) -> tuple[str, str, int, Pose]:
        """Child, parent, time and pose of the child in the parent."""
        quaternion = np.array([turn.x, turn.y, turn.z, turn.w], dtype=np.float64)
        centre = np.array([translation.x, translation.y, translation.z], dtype=np.float64)
        child, parent = str(frame).strip("/"), str(header.frame_id).strip("/")
        norm = float(np.linalg.norm(quaternion))
        if not (np.isfinite(centre).all() and abs(norm - 1) < 1e-2):
            actual = f"rotation of length {norm:g}, translation {centre.tolist()}"
            where = f"transform of {child} in {parent}"
            raise FileFormatError(self.bag.path, where=where, expected="a unit quaternion, a place", got=actual)
        time_ns = int(header.stamp.sec) * 1_000_000_000 + int(header.stamp.nanosec)
        return child, parent, time_ns, pose(rotation_from_quaternion(quaternion), centre)

    def fixed(self, target: str, source: str) -> Pose | None:
        """``target_T_source`` where both hang on one frame by fixed edges, else None.

        Raises:
            FileFormatError: If one hangs on a frame whose only transforms are no rigid motions.
        """
        of_target, of_source = dict(self._above(target)), dict(self._above(source))
        shared = next((name for name in of_source if name in of_target), None)
        if shared is None:
            for name in (*of_source, *of_target):
                if name in self._faults and name not in self.edges:
                    raise self._faults[name]
            return None
        return np.asarray(np.linalg.inv(of_target[shared]) @ of_source[shared])

    def _above(self, name: str) -> Iterable[tuple[str, Pose]]:
        """Each frame above by fixed edges, the frame itself first, with the pose in it."""
        matrix, name = np.eye(4), name.strip("/")
        for _ in range(_LONGEST_CHAIN):
            yield name, matrix
            edge = self.edges.get(name)
            if edge is None or len(edge.times_ns):
                return
            name, matrix = edge.parent, edge.parent_T_child[0] @ matrix

    def world(self, source: str, time_ns: int, tolerance_ns: int) -> Pose | None:
        """Pose in the root of the tree at a moment; None where no moving edge lies between, or it is not known then."""
        matrix, name, moved = np.eye(4), source.strip("/"), False
        for _ in range(_LONGEST_CHAIN):
            edge = self.edges.get(name)
            if edge is None:
                return matrix if moved else None
            step = edge.at(time_ns, tolerance_ns)
            if step is None:
                return None
            name, matrix, moved = edge.parent, step @ matrix, moved or len(edge.times_ns) > 0
        raise FileFormatError(self.bag.path, where=f"the transforms above {source}", expected="a tree", got="a circle")
