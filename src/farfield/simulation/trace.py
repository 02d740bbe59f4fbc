"""Ray casting: a bounding volume hierarchy over one mesh, searched by Embree."""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Float32, Int

from farfield.errors import MissingExtraError
from farfield.simulation.bodies.mesh import Mesh

_LEVEL = np.cos(np.radians(45.0))
_CORNERS = np.array([[i & 1, i >> 1 & 1, i >> 2 & 1] for i in range(8)], dtype=bool)


@dataclass(frozen=True, eq=False)
class RayHits:
    """What n rays hit first.

    Args:
        range_m: Distance along each ray, shape (n,); inf where nothing was hit.
        face: Index of the triangle, shape (n,); -1 where nothing was hit.
        cosine: Absolute cosine of the angle of incidence, shape (n,).
    """

    range_m: Float32[np.ndarray, " n"]
    face: Int[np.ndarray, " n"]
    cosine: Float32[np.ndarray, " n"]


@cache
def _device() -> Any:
    """The one device of this process: Embree fails beyond about a thousand of them."""
    from embreex.rtcore import EmbreeDevice

    return EmbreeDevice()


def _embree_scene() -> Any:
    try:
        from embreex.rtcore_scene import EmbreeScene
    except ImportError as error:
        raise MissingExtraError("embreex", "simulate", "The simulator's ray casting") from error
    return EmbreeScene(_device())


def corners_of(span_m: Float[np.ndarray, "2 3"]) -> Float[np.ndarray, "8 3"]:
    """Corners of a box by its lowest and its highest one, ordered by bits (x, y, z)."""
    return np.where(_CORNERS, span_m[1], span_m[0])


class Caster(ABC):
    """Something rigid that rays may hit: triangles, or the leaves of plants.

    Coordinates are kept relative to ``anchor_m`` so that float32 suffices.

    Attributes:
        mesh: Triangles; those of leaves stand for what a leaf looks like.
        anchor_m: A point near the rays' origins, in the mesh's frame.
        corners_m: Corners of the bounding box of all that can be hit.
        level: Which triangles lie flat (within 45 degrees), shape (f,).
        is_turbid: Whether waves longer than a leaf run on through it.
    """

    mesh: Mesh
    anchor_m: Float[np.ndarray, " 3"]
    corners_m: Float[np.ndarray, "8 3"]
    level: Bool[np.ndarray, " f"]
    is_turbid: bool = False

    def cast(self, origin_m: Float[np.ndarray, " 3"], directions: Float[np.ndarray, "n 3"]) -> RayHits:
        """First hit of each ray.

        Args:
            origin_m: Where all rays start, shape (3,), in the mesh's frame.
            directions: Unit directions, shape (n, 3).
        """
        return self.cast_from(np.broadcast_to(origin_m, directions.shape), directions)

    def cast_from(self, origins_m: Float[np.ndarray, "n 3"], directions: Float[np.ndarray, "n 3"]) -> RayHits:
        """First hit of each ray, every ray with an origin of its own."""
        rays = np.ascontiguousarray(directions, dtype=np.float32)
        return self.cast_anchored(np.ascontiguousarray(origins_m - self.anchor_m, dtype=np.float32), rays)

    @abstractmethod
    def cast_anchored(
        self,
        origins_m: Float32[np.ndarray, "n 3"],
        directions: Float32[np.ndarray, "n 3"],
        within_m: Float32[np.ndarray, " n"] | None = None,
    ) -> RayHits:
        """First hit of each ray, with origins given relative to ``anchor_m``: the fastest way in.

        Args:
            origins_m: Starts of the rays, contiguous, shape (n, 3).
            directions: Unit directions, contiguous, shape (n, 3).
            within_m: Hits farther than this need not be searched, shape (n,).
        """

    def paths_m(
        self,
        origin_m: Float[np.ndarray, " 3"],  # noqa: ARG002 - what is opaque lets nothing through
        directions: Float[np.ndarray, "n 3"],
        within_m: Float[np.ndarray, " n"],  # noqa: ARG002
    ) -> tuple[Float32[np.ndarray, " n"], Float32[np.ndarray, " n"]]:
        """How far each ray runs within plants, leaves or gaps, and where it enters the first one (inf: none).

        Args:
            origin_m: Where all rays start.
            directions: Unit directions, shape (n, 3).
            within_m: Where each ray ends, shape (n,).
        """
        return np.zeros(len(directions), dtype=np.float32), np.full(len(directions), np.inf, dtype=np.float32)


class Tracer(Caster):
    """Casts rays at one rigid mesh.

    Args:
        mesh: Triangles, in any frame; at least one.
        anchor_m: A point near the rays' origins, in the same frame.

    Attributes:
        scene: Embree's scene of the mesh, with coordinates relative to the anchor.

    Raises:
        MissingExtraError: If embreex is not installed.
    """

    def __init__(self, mesh: Mesh, *, anchor_m: Float[np.ndarray, " 3"] | None = None) -> None:
        self.mesh = mesh
        self.anchor_m = np.zeros(3) if anchor_m is None else anchor_m
        self.scene = _embree_scene()
        self.corners_m = corners_of(np.stack([mesh.vertices_m.min(axis=0), mesh.vertices_m.max(axis=0)]))
        vertices = (mesh.vertices_m - self.anchor_m).astype(np.float32)
        from embreex.mesh_construction import TriangleMesh

        self._keep = TriangleMesh(self.scene, vertices, mesh.faces.astype(np.int32))
        corners = vertices[mesh.faces].astype(np.float64)
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        length = np.maximum(np.linalg.norm(normal, axis=1), 1e-20)
        self._inverse_normal = np.append(1.0 / length, 0.0).astype(np.float32)  # the last for rays that missed
        self.level = np.abs(normal[:, 2]) > _LEVEL * length

    def cast_anchored(
        self,
        origins_m: Float32[np.ndarray, "n 3"],
        directions: Float32[np.ndarray, "n 3"],
        within_m: Float32[np.ndarray, " n"] | None = None,  # noqa: ARG002 - Embree is as fast without
    ) -> RayHits:
        """First hit of each ray; see :meth:`Caster.cast_anchored`."""
        if len(directions) == 0:
            none = np.zeros(0, dtype=np.float32)
            return RayHits(none, np.zeros(0, dtype=np.int32), none)
        out = self.scene.run(origins_m, directions, output=1)
        face: Int[np.ndarray, " n"] = out["primID"]
        range_m: Float32[np.ndarray, " n"] = out["tfar"]
        range_m[face < 0] = np.inf
        cosine = np.einsum("ij,ij->i", out["Ng"], directions)
        np.abs(cosine, out=cosine)
        cosine *= self._inverse_normal[face]
        return RayHits(range_m, face, cosine)


@dataclass(frozen=True, eq=False)
class Body:
    """A rigid body that rays can hit, and where it is at each knot of a span of time.

    Args:
        tracer: What of it rays may hit, in its own frame.
        world_T_body: Its pose at each knot, shape (k, 4, 4).
        actor: Row of the road user within the scene's window, or -1 for what is fixed.
    """

    tracer: Caster
    world_T_body: Float[np.ndarray, "k 4 4"]
    actor: int = -1
