"""The eight road structures of K-Radar; each builder draws one sequence's layout."""

from collections.abc import Callable

from farfield.simulation.world.layout import RoadBuild, RoadLayout
from farfield.simulation.world.roads.campus import build_parking_lot, build_university
from farfield.simulation.world.roads.country import build_highway, build_mountain, build_shoulder
from farfield.simulation.world.roads.town import build_alleyway, build_suburban, build_urban

__all__ = ["BUILDERS", "RoadBuild"]

BUILDERS: dict[str, Callable[[RoadBuild], RoadLayout]] = {
    "urban": build_urban,
    "highway": build_highway,
    "alleyway": build_alleyway,
    "suburban": build_suburban,
    "university": build_university,
    "mountain": build_mountain,
    "parking_lot": build_parking_lot,
    "shoulder": build_shoulder,
}
